"""Terrain over the dome: mountains repel, valleys attract, slopes push sideways; inset of Zárate 2020 Fig. 1."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from io import BytesIO
from math import acos, atan2, cos, radians, sin, sqrt
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array
from haptorb.compiled import kernel
from haptorb.devices.base import Device, State
from haptorb.errors import InputError
from haptorb.files import read_bytes
from haptorb.worlds.base import World, parameter

__all__ = ["Terrain", "hills"]

_MAX_IMAGE_BYTES = 64 * 1024 * 1024  #: maximum size of an image file
_MAX_IMAGE_PIXELS = 4096  #: maximum side length of an image


@kernel
def _height(heights: Array, u: float, v: float, out: Array) -> None:
    """out (3,): height and its slopes by u and v, u and v in 0…1 over the array; Catmull–Rom, constant beyond the
    edge."""
    rows, columns = heights.shape
    if not np.isfinite(u + v):  # no index
        out[0] = out[1] = out[2] = np.nan
        return
    x = min(max(u, 0.0), 1.0) * (columns - 1)
    y = min(max(v, 0.0), 1.0) * (rows - 1)
    i, j = min(int(x), columns - 2), min(int(y), rows - 2)
    s, t = x - i, y - j
    wx = (
        -0.5 * s + s**2 - 0.5 * s**3,
        1 - 2.5 * s**2 + 1.5 * s**3,
        0.5 * s + 2 * s**2 - 1.5 * s**3,
        -0.5 * s**2 + 0.5 * s**3,
    )
    wy = (
        -0.5 * t + t**2 - 0.5 * t**3,
        1 - 2.5 * t**2 + 1.5 * t**3,
        0.5 * t + 2 * t**2 - 1.5 * t**3,
        -0.5 * t**2 + 0.5 * t**3,
    )
    dx = (-0.5 + 2 * s - 1.5 * s**2, -5 * s + 4.5 * s**2, 0.5 + 4 * s - 4.5 * s**2, -s + 1.5 * s**2)
    dy = (-0.5 + 2 * t - 1.5 * t**2, -5 * t + 4.5 * t**2, 0.5 + 4 * t - 4.5 * t**2, -t + 1.5 * t**2)
    h, hx, hy = 0.0, 0.0, 0.0
    for b in range(4):
        for a in range(4):
            value = heights[min(max(j + b - 1, 0), rows - 1), min(max(i + a - 1, 0), columns - 1)]
            h += wy[b] * wx[a] * value
            hx += wy[b] * dx[a] * value
            hy += dy[b] * wx[a] * value
    out[0], out[1], out[2] = h, hx * (columns - 1), hy * (rows - 1)


def _check_heights(heights: ArrayLike) -> Array:
    """`heights` as an array, or InputError with its first missing value."""
    try:
        filled = np.ma.filled(np.ma.asarray(heights, dtype=np.float64), np.nan)
    except (TypeError, ValueError, OverflowError) as cause:
        raise InputError(f"Terrain.heights must be a table of numbers; {cause}") from cause
    holes = np.argwhere(~np.isfinite(filled))
    if len(holes):
        raise InputError(
            f"Terrain.heights has {len(holes)} holes (NaN, infinite or masked), the first at {holes[0].tolist()}; "
            "fill them first"
        )
    whole: Array = np.ascontiguousarray(filled)
    return whole


def hills(size: int = 65) -> Array:
    """(size, size) terrain with three mountains and two valleys, heights −1…1 [1]."""
    v, u = np.meshgrid(np.linspace(-1, 1, size), np.linspace(-1, 1, size), indexing="ij")
    places = (
        (0.35, 0.1, 0.22, 1.0),
        (-0.3, 0.35, 0.18, 0.8),
        (-0.1, -0.45, 0.2, 0.9),
        (0.0, 0.0, 0.2, -0.8),
        (0.5, -0.4, 0.2, -0.9),
    )
    return sum(a * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * w * w)) for x, y, w, a in places)  # type: ignore[return-value]


@dataclass(frozen=True)
class Terrain(World):
    """Height map h over the dome as a potential U = F₀ h (d_c/3)(d_c/d)³: height pushes outward, slope pushes sideways.

    F_r = F₀ h (d_c/d)⁴, F_t = −F₀ (d_c/d)³ (d_c/3d) ∂h/∂angle; a gradient, hence passive, and with the same
    decrease with distance as the device's own magnets. Heights (n, n) span the square around the workspace seen from
    above (azimuthal equidistant: distance from the centre is tilt); a height of 1 is `strength` at contact.

    Parameters
    ----------
    heights : array_like, shape (n, n)
        Heights [1] within −1 and 1, times `strength`, n from 4 to 4096; rows go from −y to +y, columns from −x to +x.
        The default has three mountains and two valleys.
    contact_distance : float
        Distance d_c of the tool's magnet from the centre at contact [m], positive; `for_device` sets it.
    reach : float
        Distance beyond which the force is zero [m], above `contact_distance`; `for_device` sets it.
    """

    asks = "force"
    continuous: ClassVar[bool] = False

    strength: float = parameter(0.5, "N", -1, 1, "F0: radial force for a height of 1, at contact")
    half_angle_deg: float = parameter(60.0, "deg", 10, 90, "tilt at the edge of the map")
    heights: Array = field(default_factory=hills)
    contact_distance: float = 0.050
    reach: float = 0.070

    def __post_init__(self) -> None:
        World.__post_init__(self)
        heights = _check_heights(self.heights)
        if heights.ndim != 2 or heights.shape[0] != heights.shape[1] or not 4 <= len(heights) <= _MAX_IMAGE_PIXELS:
            raise InputError(
                f"Terrain.heights must be square, shape (n, n) with n of at least 4, at most {_MAX_IMAGE_PIXELS}; got "
                f"{heights.shape}"
            )
        if np.abs(heights).max() > 1 + 1e-9:
            raise InputError(
                f"Terrain.heights must lie within −1…1 (the strength scales them); got up to {np.abs(heights).max():g}"
            )
        object.__setattr__(self, "heights", np.ascontiguousarray(heights))

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Terrain)
            and (self.strength, self.half_angle_deg) == (other.strength, other.half_angle_deg)
            and np.array_equal(self.heights, other.heights)
        )

    __hash__ = None  # type: ignore[assignment]

    @classmethod
    def of(cls, function: Callable[[Array, Array], ArrayLike], size: int = 65, **values: float) -> Terrain:
        """Make a terrain from a function.

        Parameters
        ----------
        function : callable
            (tilt, azimuth) → heights: arrays of shape (`size`, `size`); tilt from the axis z [rad], azimuth about it
            from x [rad], heights within −1 and 1 [1].
        size : int, optional
            Heights along each side of the map, from 4 to 4096.
        **values : object
            Parameters of the terrain.

        Returns
        -------
        Terrain
            The terrain.

        Raises
        ------
        InputError
            For heights that are missing, out of range or not of that shape.
        """
        half = radians(values.get("half_angle_deg", 60.0))
        v, u = np.meshgrid(np.linspace(-1, 1, size), np.linspace(-1, 1, size), indexing="ij")
        return cls(heights=np.asarray(function(half * np.hypot(u, v), np.arctan2(v, u))), **values)

    @classmethod
    def image(cls, path: str | Path, **values: float) -> Terrain:
        """Make a terrain from a greyscale image.

        Parameters
        ----------
        path : str or Path
            File of a square image, such as PNG, of at most 4096 pixels a side. Black is −1, white is +1; its top is +y.
        **values : object
            Parameters of the terrain.

        Returns
        -------
        Terrain
            The terrain.

        Raises
        ------
        InputError
            For a file that is no square image, or has transparent pixels.
        """
        from PIL import Image, UnidentifiedImageError

        try:
            content = read_bytes(path, _MAX_IMAGE_BYTES, "height map", InputError)
            # Other formats of PIL start system programs, such as the one for PostScript.
            with Image.open(BytesIO(content), formats=("PNG", "TIFF", "JPEG", "BMP", "GIF", "PPM")) as picture:
                if max(picture.size) > _MAX_IMAGE_PIXELS:
                    raise InputError(
                        f"height map '{path}' has more than {_MAX_IMAGE_PIXELS} pixels a side; make it smaller"
                    )
                deep = picture.mode.startswith("I")  # 16-bit greyscale
                if picture.mode in ("LA", "PA", "RGBA") and np.asarray(picture.getchannel("A")).min() < 255:
                    raise InputError(f"height map '{path}' has transparent pixels: holes; fill them first")
                grey = np.asarray(picture if deep else picture.convert("L"), dtype=float) / (65535 if deep else 255)
        except InputError:
            raise
        except (OSError, UnidentifiedImageError, ValueError, SyntaxError, Image.DecompressionBombError) as cause:
            raise InputError(f"height map '{path}' cannot be read as an image: {cause}") from cause
        if grey.shape[0] != grey.shape[1]:
            raise InputError(f"height map '{path}' must be square; it is {grey.shape[1]} × {grey.shape[0]} pixels")
        return cls(heights=2 * grey[::-1] - 1, **values)

    def for_device(self, device: Device) -> Terrain:
        """With the contact distance and the shell of `device`. Raises InputError for a device without a dome."""
        shell = device.shell
        if shell is None:
            raise InputError(f"world 'terrain' is for a tool over a sphere; device '{device.name}' has none")
        contact = shell.contact_distance
        return replace(self, contact_distance=contact, reach=contact + shell.thickness)

    @property
    def bound(self) -> float:
        """[N] from the largest height and slope of the cells; the interpolation overshoots both by less than 1.6."""
        pixel = 2 * radians(self.half_angle_deg) / (len(self.heights) - 1)
        slope = max(float(np.abs(np.diff(self.heights, axis=axis)).max()) for axis in (0, 1)) / pixel
        edge = 1.5 / (0.2 * radians(self.half_angle_deg))  # maximum slope of the fade-out itself
        steepest = np.pi / 2 * (2.0**0.5 * slope + edge * float(np.abs(self.heights).max()))
        return float(1.6 * abs(self.strength) * np.hypot(np.abs(self.heights).max(), steepest / 3))

    def wrench(self, state: State) -> Array:
        """(6,) force of the terrain [N]."""
        wrench = np.zeros(6)
        x, y, z = state.p.tolist()
        d = sqrt(x * x + y * y + z * z)
        if d == 0.0 or d >= self.reach:
            return wrench
        theta, phi = acos(min(1.0, max(-1.0, z / d))), atan2(y, x)
        half = radians(self.half_angle_deg)
        if theta >= half:
            return wrench
        out = np.empty(3)
        _height(self.heights, 0.5 + 0.5 * theta / half * cos(phi), 0.5 + 0.5 * theta / half * sin(phi), out)
        h, hu, hv = out.tolist()
        # The terrain fades out towards the edge of the map, so that its rim is not a step.
        s = min(max((half - theta) / (0.2 * half), 0.0), 1.0)
        fade, fall = s * s * (3 - 2 * s), -6 * s * (1 - s) / (0.2 * half)
        by_theta = fade * 0.5 / half * (hu * cos(phi) + hv * sin(phi)) + fall * h
        by_phi = 0.0 if theta < 1e-9 else fade * 0.5 / half * (hv * cos(phi) - hu * sin(phi)) * theta / sin(theta)
        ratio = self.contact_distance / max(d, self.contact_distance)
        radial = self.strength * fade * h * ratio**4
        side = -self.strength * ratio**3 * self.contact_distance / (3 * d)
        e_theta = (cos(theta) * cos(phi), cos(theta) * sin(phi), -sin(theta))
        e_phi = (-sin(phi), cos(phi), 0.0)
        for i, p in enumerate((x, y, z)):
            wrench[i] = radial * p / d + side * (by_theta * e_theta[i] + by_phi * e_phi[i])
        return wrench
