"""Error model of a spherical electromagnet: from the commanded force to the force on the tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol, final

import numpy as np
from scipy.special import ndtr

from haptorb.analysis.error_budget import Component, ErrorModel, ErrorSource, choose_size
from haptorb.analysis.error_sources import (
    ChainTrial,
    CurrentLoop,
    Effect,
    SensorTrial,
    add_to,
    current_sources,
    describe_share,
    find_origin,
    magnet_warmth,
    multiply,
    sensor_sources,
    source,
    strengthen,
)
from haptorb.arrays import Array
from haptorb.control.allocation import force_allocator
from haptorb.devices.base import State, rotation_to_axis
from haptorb.devices.core_parameters import CoreDynamics
from haptorb.devices.electromagnet import COILS_AS_POINTS, FORCE_JND, SphericalElectromagnet
from haptorb.devices.electromagnet_capability import shell_capability
from haptorb.devices.electromagnet_wrench_map import WoundCoils, fill_wound, ring_per_ampere
from haptorb.devices.uncertainty import ElectromagnetTolerance
from haptorb.display import format_quantity
from haptorb.errors import UnknownName
from haptorb.estimation.calibration_file import Calibration
from haptorb.estimation.coil_calibration import find_response
from haptorb.estimation.hall_pose_fit import ToolModel, coil_field, moment_field, tool_field
from haptorb.estimation.hall_tracker import CALIBRATED
from haptorb.magnetics.coil import CentredCoil
from haptorb.magnetics.core_attraction import pull
from haptorb.magnetics.dipole import point_field
from haptorb.magnetics.magnets import ChargedRing
from haptorb.magnetics.soft_sphere import SoftSphere
from haptorb.rotations import turn_by

__all__ = ["HallFit", "HallPoint", "MomentFit", "ToolErrors", "ToolPoint", "ToolTrial", "tool_errors"]


# --------------------------------------------------------------------------------------------------
# Hall tracker's pose estimate for magnets, coils, currents and sensors that differ from its model.
#
# One step of the tracker's own weighted least squares, from the true pose: first order in the errors.


class CalibratedTrial(Protocol):
    """Data that a calibration depends on."""

    moments: Array
    gain: Array
    placement: Array
    reading: Array

    def read_field(self, field: Array, frames: Array | None = None) -> Array:
        """Sensor readings of a field."""


class HallPoint(NamedTuple):
    """Tracker's least squares linearised about one true pose."""

    field: Array  #: (k, 3) of the estimated tool at the sensors [T]
    solve: (
        #: (5, 3 k) from the residuals of the readings to the position [m/T] and the rotations about R's x and y [rad/T]
        Array
    )


class HallFit:
    """Hall tracker of `device`; calibrated: the sensors' offsets were measured, and are subtracted."""

    def __init__(self, device: SphericalElectromagnet, *, calibrated: bool = False) -> None:
        self._model, self._per_ampere = ToolModel.of(device), coil_field(device)
        hall, supply = device.hall, device.supply
        noise = np.hypot(max(hall.noise, 1e-7), hall.step / np.sqrt(12))
        self._noise = float(noise if calibrated else np.hypot(noise, hall.errors.offset))
        moments = device.moment_per_current
        self._read = (supply.current_noise**2 + supply.current_step**2 / 12) * (moments @ moments.T)
        self._read = self._read + device.core_dynamics.remanent_moment**2 * np.eye(3)
        self._columns = (moments**2).sum(axis=0)
        self._unit = moment_field(device).reshape(-1, 3)
        self._moments = moments
        self._coils = device.coil_fields(device.hall.positions.reshape(-1, 3))  # (k, 3, m)
        self._slopes = coil_slopes(device)

    def linearize(self, p: Array, R: Array, currents: Array) -> HallPoint:
        """Linearise at the tool pose p (3,) [m], R (3, 3), with the tracker's weights under `currents` (m,) [A]."""
        field, slopes = self._field(self._model, p, R)
        moments = self._read + CALIBRATED**2 * float(self._columns @ currents**2) * np.eye(3)
        spread = self._noise**2 * np.eye(len(self._unit)) + self._unit @ moments @ self._unit.T
        design = slopes.reshape(-1, 5)
        weighted = np.linalg.solve(spread, design).T
        return HallPoint(field, np.linalg.solve(weighted @ design, weighted))

    def _field(self, model: ToolModel, p: Array, R: Array) -> tuple[Array, Array]:
        field, slopes = np.empty((len(model.sensors), 3)), np.empty((len(model.sensors), 3, 5))
        tool_field(model, np.ascontiguousarray(p), np.ascontiguousarray(R), field, slopes)
        return field, slopes

    def read(
        self, trial: SensorTrial, tool: State, strength: float, moments: Array, extra: Array, currents: Array,
        more: Array,
    ) -> Array:  # fmt: skip
        """(k, 3) [T] readings minus the tracker's model of the currents' field; `more` (k, 3) [T] is added to the
        field.

        The magnet of `tool` has `strength` times the model's remanence; the coils have `moments` (3, m) [m²] per true
        ampere of `currents` (m,) [A], and the core the moment `extra` (3,) [A·m²] beside that. Core and coils are at
        the origin, the sensors off by their placement.
        """
        model = self._model._replace(sensors=np.ascontiguousarray(self._model.sensors + trial.placement))
        field = strength * self._field(model, tool.p, tool.R_SR)[0]
        # coil strength errors scale the field; its components across the axes are a dipole's
        scale = (moments * self._moments).sum(axis=0) / self._columns
        across = moments - scale * self._moments
        amperes = scale * currents
        field += self._coils @ amperes + np.einsum("kijm,kj,m->ki", self._slopes, trial.placement, amperes)
        field += point_field(model.sensors) @ (across @ currents + extra) + more
        left: Array = trial.read_field(field) - self._per_ampere @ trial.read_currents(currents)
        return left


class MomentFit:
    """Moments found by a calibration of `device` with its own current and field sensors."""

    def __init__(self, device: SphericalElectromagnet) -> None:
        self._places = np.asarray(device.hall.positions, dtype=np.float64).reshape(-1, 3)
        unit = moment_field(device).reshape(-1, 3)
        self._solve = np.linalg.solve(unit.T @ unit, unit.T)

    def find_true(self, trial: CalibratedTrial, more: Array) -> Array:
        """(3, m) [m²] true moments per ampere for which sensors with the errors of `trial` give the calibrated moments.

        more (k, 3, m) [T/A]: the field of the coils at the sensors beside that of coils as in the file.
        """
        at = self._places + trial.placement
        fields = [trial.read_field(field) for field in np.moveaxis(point_field(at), 2, 0)]
        read = np.stack([field - trial.reading for field in fields], axis=2).reshape(-1, 3)
        seen = trial.moments - self._solve @ more.reshape(read.shape[0], -1)
        moments: Array = np.linalg.solve(self._solve @ read, seen) * (1 + trial.gain)
        return moments


class CentreFit:
    """Moments and centres of the coils that a calibration found with the device's own sensors; `device` has them.

    What the calibration leaves is not independent of the errors it starts from: a sensor off its place, or a winding of
    another size, moves the centres that it finds, and the core pulls the tool from where it is. So all these errors go
    through the calibration's own regression, to first order.
    """

    def __init__(self, device: SphericalElectromagnet, calibration: Calibration) -> None:
        assert calibration.centres is not None
        unit, far = moment_field(device).reshape(-1, 3), device.far_moments
        self._stated = np.linalg.norm(device.moment_per_current, axis=0) / np.linalg.norm(far, axis=0)
        share = np.diag(np.linalg.inv(unit.T @ unit))
        noise = ((calibration.uncertainty / self._stated) ** 2 / share[:, None]).mean(axis=0)
        self._moments, self._centres = find_response(device, far, calibration.centres, noise)
        places = np.asarray(device.hall.positions, dtype=np.float64).reshape(-1, 3)
        self._field, self._slopes = device.coil_fields(places), coil_slopes(device)

    def find_errors(self, trial: ToolTrial, more: Array) -> tuple[Array, Array]:
        """(3, m) [m²] found minus true moments per ampere, and (m, 3) [m] the centres found for coils that are
        `trial.built` off theirs.

        more (k, 3, m) [T/A]: the field of such coils at the sensors beside that of coils as calibrated.
        """
        seen = trial.placement - trial.shift  # from core and coils, which are off their place
        field = self._field + np.einsum("kijm,kj->kim", self._slopes, seen) + more
        error = (field + np.einsum("kij,kjm->kim", trial.mixing, field) - self._field).ravel()
        return self._stated * (self._moments @ error), self._centres @ error


def coil_slopes(device: SphericalElectromagnet) -> Array:
    """(k, 3, 3, m) [T/(A·m)] derivative of the coils' fields at the field sensors by position, the second last axis."""
    at, h = device.hall.positions.reshape(-1, 3), 1e-5
    ahead, behind = (device.coil_fields((at + sign * h * np.eye(3)[:, None]).reshape(-1, 3)) for sign in (1, -1))
    slopes: Array = np.moveaxis(((ahead - behind) / (2 * h)).reshape(3, len(at), 3, -1), 0, 2)
    return slopes


# --------------------------------------------------------------------------------------------------
# Manufacturing errors of coils and core: effect on the wrench on the magnet, and on the field at the sensors.
#
# A displaced winding moves its own field; the core's response remains centred on the core, except for the second
# harmonic of the response to an off-centre winding (`Windings.response_shift`). Other sizes change the strengths of the
# zonal terms. Where the moments per ampere were measured as fields, all this is relative to the same field at the
# point of measurement.


SIZES = ("inner_radius", "outer_radius", "length")
_SIZE_STEP_M = 2e-5  #: step of a derivative by a size [m]


@dataclass
class BuiltTrial:
    """Deviations of windings and core of one device from its file."""

    offsets: Array  #: (3, 3) [m] of each winding from the centre
    whole: Array  #: (3, 3) [m] of each winding with the core's response to it, from its position in the model
    sizes: Array  #: (3, 3) [m] excess of inner radius, outer radius and length (rows) of each winding
    core: Array  #: (3,) [m] of the core from the centre
    softness: float  #: 1/permeability minus the file's
    earth: Array  #: (3,) [T]

    @classmethod
    def exact(cls) -> BuiltTrial:
        """No deviations."""
        return cls(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), 0.0, np.zeros(3))


class BuiltCoils:
    """Coils of `device`, with known sizes, with the deviations of a `BuiltTrial`."""

    def __init__(self, device: SphericalElectromagnet) -> None:
        assert device.windings is not None
        wound, windings, core = device.wound_coils, device.windings, device.core
        count = wound.terms.shape[1]
        alone = SoftSphere(core.radius, 1.0)
        self._wound, self._sizes = wound, np.linalg.norm(device.moment_per_current, axis=0)
        raw, alone_terms = (
            np.stack([CentredCoil(coil, ball, wound.nearest).terms(wound.reach, count) for coil in windings.coils])
            for ball in (core, alone)
        )
        self._shift = windings.response_shift(core)
        self._own: Array = alone_terms * (wound.terms[:, :1] / raw[:, :1])
        self._core: Array = wound.terms - self._own
        closest = max(device.contact_distance - device.tool.length / 2, device.dome_radius)
        measured = device.moments_from == "device file"
        slopes = []
        for name in SIZES:
            either = []
            for step in (_SIZE_STEP_M, -_SIZE_STEP_M):
                sizes = replace(windings, **{name: getattr(windings, name) + step})
                moments = device.moment_per_current
                if device.moments_from == "windings":
                    was, now = (one.moment_per_current(core, device.moments_at) for one in (windings, sizes))
                    moments = moments * (np.diag(now) / np.diag(was))
                made = sizes.wound(core, moments, device.moments_at, wound.nearest, closest)
                padded = np.zeros_like(wound.terms)
                many = min(count, made.terms.shape[1])
                degrees = 2 * np.arange(many) + 2
                padded[:, :many] = made.terms[:, :many] * (made.reach / wound.reach) ** degrees
                either.append(padded)
            slopes.append((either[0] - either[1]) / (2 * _SIZE_STEP_M))
        self._by_size = np.stack(slopes)  # (3 sizes, m, k)
        # relative change of the field at its point of measurement, per displacement of winding and core along the axis
        # [1/m]
        self._steeper = np.zeros((2, device.channels))
        if measured and np.isfinite(device.moments_at):
            n = 2 * np.arange(count) + 1
            share = (n + 1) * (wound.reach / device.moments_at) ** (n + 2)
            whole = wound.terms @ share
            for row, terms in enumerate((self._own, self._core)):
                self._steeper[row] = terms @ (share * (n + 2)) / whole / device.moments_at
        self._sensors = np.ascontiguousarray(np.asarray(device.hall.positions, dtype=np.float64).reshape(-1, 3))

    def map(self, rows: Array, built: BuiltTrial, moments: Array, more: Array, p: Array, R: Array) -> Array:
        """(6, m) [N/A, N·m/A] on charges `rows` (4, n) at p (3,) [m], R (3, 3), for `moments` (3, m) [m²].

        more (m, k) [T·m/A]: added to the windings' terms, for a core of another size.
        """
        sizes, wound = np.linalg.norm(moments, axis=0), self._wound
        axes = np.ascontiguousarray((moments / sizes).T)
        moved = built.core + np.einsum("jab,jb->ja", self._shift, built.core - built.offsets)
        along, core = (built.offsets * axes).sum(axis=1), (moved * axes).sum(axis=1)
        scale = sizes / self._sizes / (1.0 + self._steeper[0] * along + self._steeper[1] * core)
        winding: Array = self._own + more + np.einsum("sjk,sj->jk", self._by_size, built.sizes)
        own, responses = (np.ascontiguousarray(scale[:, None] * terms) for terms in (winding, self._core))
        out, windings, middle = np.empty((6, len(sizes))), np.empty((6, len(sizes))), wound.centres + built.whole
        fill_wound(rows, responses, wound.reach, wound.nearest, axes, middle + moved, p, R, out)
        fill_wound(rows, own, wound.reach, wound.nearest, axes, middle + built.offsets, p, R, windings)
        out += windings
        return out

    def add_field(self, built: BuiltTrial, moments: Array) -> Array:
        """(k, 3, m) [T/A] field of such coils at the field sensors minus that of coils as in the file."""
        found, upright = np.empty((len(self._sensors), 3, len(self._sizes))), np.eye(3)
        none, unit = np.zeros_like(self._own), np.array([[0.0], [0.0], [0.0], [1.0]])
        for k, at in enumerate(self._sensors):
            there, here = (self.map(unit, one, moments, none, at, upright) for one in (built, BuiltTrial.exact()))
            found[k] = there[:3] - here[:3]
        return found


def _permeability(bounds: tuple[float, float], file: float, origin: str) -> ErrorSource[ToolTrial]:
    """Permeability of the core, evenly by its logarithm: it changes its response to the tool; the moments are measured
    with it."""
    low, high = np.log(bounds)

    def perturb(deviates: Array, trial: ToolTrial) -> None:
        trial.built.softness += float(np.exp(-(low + (high - low) * ndtr(deviates[0])))) - 1.0 / file

    return ErrorSource("permeability of the core", f"{bounds[0]:g} to {bounds[1]:g}", origin, 1, perturb)


def _earth_field(size: float, origin: str) -> ErrorSource[ToolTrial]:
    """Uniform field at the device's location, in a random direction."""

    def perturb(deviates: Array, trial: ToolTrial) -> None:
        trial.built.earth += size * deviates / np.linalg.norm(deviates)

    return ErrorSource("earth's field", format_quantity(size, "T"), origin, 3, perturb)


def _tilt_windings(trial: ToolTrial, lean: Array) -> None:
    """Rotate the computed moments by `lean` (9,) [rad]."""
    trial.moments += np.cross(lean.reshape(3, 3), trial.moments.T).T


def _change_layers(device: SphericalElectromagnet, *, moments: bool) -> tuple[int, Effect]:
    """Number of layers of all windings, and the effect of so many turns more in each.

    They move the middle of a winding's turns outwards or inwards, as a winding does whose both radii change; so does a
    last layer that is not full, as the model fills the section evenly. `moments`: these follow the number of turns.
    """
    assert device.windings is not None
    windings = device.windings
    layers = windings.list_layers(device.coils.resistance, device.coils.copper_resistivity)
    ends = np.cumsum([len(one) for one in layers])

    def change(trial: ToolTrial, turns: Array) -> None:
        for number, (nominal, more) in enumerate(zip(layers, np.split(turns, ends[:-1]), strict=True)):
            depth = float(windings.outer_radius[number] - windings.inner_radius[number])
            at = depth * (np.arange(len(nominal)) + 0.5) / len(nominal)
            now = nominal + more
            trial.built.sizes[:2, number] += now @ at / now.sum() - 0.5 * depth
            if moments:
                trial.moments[:, number] *= now.sum() / nominal.sum()

    return int(ends[-1]), change


def built_sources(
    device: SphericalElectromagnet, known: ElectromagnetTolerance, calibration: Calibration | None
) -> list[ErrorSource[ToolTrial]]:
    """Sources of windings and core from [tolerance]; a `calibration` with a load cell replaces those of positions."""

    def origin(key: str) -> str:
        if f"tolerance.{key}" in device.assumed:
            return "assumed"
        return "device file" if key in known.model_fields_set else "default"

    weighed = calibration is not None and calibration.strength_uncertainty is not None
    placed = calibration.centre_uncertainty if calibration is not None and weighed else None
    found: list[ErrorSource[ToolTrial]] = [
        _permeability(known.core_permeability, device.core_permeability, origin("core_permeability")),
        _earth_field(known.earth_field, origin("earth_field")),
    ]
    if placed is not None:
        text = format_quantity(float(np.sqrt((placed**2).mean())), "m")
        found.append(source("centres of the coils", placed, text, "calibration", placed.size, add_to("built.whole")))
    else:
        where = "position of the core in the windings"
        from_file = origin("core_position")
        found.append(source(where, known.core_position, "m", from_file, 3, add_to("built.core"), evenly=True))
    if device.has_sizes:
        if placed is None:
            offsets = add_to("built.offsets")
            found.append(
                source("positions of the windings", known.position, "m", origin("position"), 9, offsets, evenly=True)
            )
        sizes = add_to("built.sizes")
        found.append(source("sizes of the windings", known.winding, "m", origin("winding"), 9, sizes, evenly=True))
        computed = device.moments_from == "windings" and calibration is None
        layers, change = _change_layers(device, moments=computed)
        found.append(
            source(
                "turns of each layer of the windings", known.turns_per_layer, f"{known.turns_per_layer:g} turns",
                origin("turns_per_layer"), layers, change, evenly=True,
            )
        )  # fmt: skip
        if computed:
            turns, m = multiply("moments"), device.channels
            found += [
                source("axes of the windings", known.tilt, "rad", origin("tilt"), 9, _tilt_windings, evenly=True),
                source("turns of the windings", known.turns, "1", origin("turns"), m, turns, evenly=True),
            ]
    return found


# --------------------------------------------------------------------------------------------------
# Error chain of a spherical electromagnet, from the commanded force to the force on the tool.
#
# The controller uses the device file and a pose; the true device has other magnets, other currents and another pose.
# Both use the device's first model; errors of that model are not part of the budget. The force is static: the effects
# of the loop's delay and the coils' inductance on a changing force are known, not uncertain.


REGIONS = ("in contact", "lower half of the shell", "upper half of the shell")
COMPONENTS = (Component("radial", (2,)), Component("tangential", (0, 1)))


@dataclass
class ToolTrial(SensorTrial):
    """Deviations of one device from its model."""

    strength: float  #: remanence of the tool's magnet, true over model
    moments: Array  #: (3, 3) true moment per ampere [m²]
    core_radius: float  #: true minus model [m]
    shift: Array  #: (3,) of core and coils from the frame's origin [m]
    place: Array  #: (3,) estimated minus true position of the tool's magnet [m]
    turn: Array  #: (3,) rotation from the tool's true to its estimated axis [rad]
    remanent: Array  #: (3,) remanent moment of the core [A·m²]
    lag: complex  #: relative reduction and lag of a rotating moment by eddy currents
    turning: Array  #: (3,) any vector; its part normal to the force is the direction in which the force rotates
    built: BuiltTrial  #: deviations of windings and core

    def strengthen(self, factors: Array) -> None:
        """Multiply the magnet's strength by `factors` (1,)."""
        self.strength *= float(factors[0])


class ToolPoint(NamedTuple):
    """Radial tool, and the commanded force."""

    p: Array  #: (3,) [m]
    R: Array  #: (3, 3); its columns are two tangents and the radius
    wrench: Array  #: (6,) [N, N·m]
    hall: HallPoint | None  #: with the pose from field sensors


@final
class ToolErrors(ErrorModel[ToolTrial, ToolPoint]):
    """Error model of `device` for forces of `asked` [N], with `sources`.

    estimator          "tracker" or "hall"
    radius_span [m]    up to how far from the device file's the core's radius is looked up, less where the magnet is
                       near; 0: it is exact
    calibration        that of `device` with its own sensors, whose errors are in it; None: there is none, or one with a
                       load cell
    frequency [Hz]     at which the force turns
    """

    unit, jnd, regions, components = "N", FORCE_JND, REGIONS, COMPONENTS

    def __init__(
        self,
        device: SphericalElectromagnet,
        asked: float,
        sources: tuple[ErrorSource[ToolTrial], ...],
        estimator: str,
        radius_span: float,
        *,
        calibration: Calibration | None = None,
        frequency: float = 0.0,
    ) -> None:
        self.device, self.estimator, self.asked, self.sources = device.name, estimator, asked, sources
        self._device = device
        self._allocator, self._loop = force_allocator(device), CurrentLoop(device)
        # After a self-calibration the accuracy of the pose from the sensors is known.
        senses = estimator == "hall" and device.hall.correction is None
        self._hall = HallFit(device, calibrated=calibration is not None) if senses else None
        self._calibrated: MomentFit | CentreFit | None = None
        if calibration is not None:
            self._calibrated = MomentFit(device) if calibration.centres is None else CentreFit(device, calibration)
        self.motion = f"turning at {frequency:g} Hz" if frequency else "at rest"
        tool = device.tool
        self._rows = ChargedRing(tool.outer_radius, tool.inner_radius, tool.length, tool.remanence).rows
        self._moments = np.array(device.moment_per_current, dtype=np.float64, order="C")
        self._far = np.linalg.norm(device.far_moments, axis=0) / np.linalg.norm(self._moments, axis=0)
        self._pull = device.passive_pull
        air = self._pull.nearest - self._pull.core_radius - max(tool.length / 2, tool.outer_radius)
        self._span = max(min(radius_span, 0.3 * air, 0.5 * device.core_radius), 1e-9)
        self._tables = [self._tabulate(k * self._span) if radius_span else self._pull.table for k in (-1, 0, 1)]
        spans = (-1, 0, 1) if radius_span else (0, 0, 0)
        self._wound = [self._wind(k * self._span) for k in spans] if device.has_sizes else None
        self._built = BuiltCoils(device) if device.has_sizes else None
        hard = 1.0 / device.core_permeability
        softest = max(_MIN_INVERSE_PERMEABILITY, 2.0 * hard)
        self._softer: Array = (self._tabulate(0.0, 1.0 / softest) - self._pull.table) / (softest - hard)

    def _tabulate(self, more: float, permeability: float | None = None) -> Array:
        """Table of the core's attraction for a radius larger by `more` [m], or for another permeability."""
        known = self._pull
        soft = known.core_permeability if permeability is None else permeability
        return replace(known, core_radius=known.core_radius + more, core_permeability=soft).table

    def _wind(self, more: float) -> WoundCoils:
        """Coils with as many terms as in the model, for a core radius larger by `more` [m]; their measured
        fields are the same."""
        wound = replace(self._device, core_radius=self._device.core_radius + more).wound_coils
        terms = np.zeros_like(self._device.wound_coils.terms)
        terms[:, : wound.terms.shape[1]] = wound.terms[:, : terms.shape[1]]
        return wound._replace(terms=terms)

    def draw_point(self, region: int, rng: np.random.Generator) -> ToolPoint:
        """Random point in the region, uniform over the dome; the tool is radial, the force in any direction."""
        device = self._device
        cosine = rng.uniform(np.cos(device.workspace_half_angle), 1.0)
        azimuth, height = rng.uniform(0, 2 * np.pi), rng.uniform(0.5 * region - 0.5, 0.5 * region)
        flat = np.sqrt(1 - cosine * cosine)
        axis = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), cosine])
        distance = device.contact_distance + max(height, 0.0) * device.shell_thickness
        wrench = np.zeros(6)
        direction = rng.standard_normal(3)
        wrench[:3] = self.asked * direction / np.linalg.norm(direction)
        p, R = distance * axis, rotation_to_axis(axis)
        if self._hall is None:
            return ToolPoint(p, R, wrench, None)
        state = State(0.0, R, p, np.zeros(3), np.zeros(3))
        currents = self._allocator.allocate(device.wrench_map(state, device.models[0]), wrench).currents
        return ToolPoint(p, R, wrench, self._hall.linearize(p, R, currents))

    def make_trial(self) -> ToolTrial:
        """Device without errors."""
        exact, k = ChainTrial.exact(self._device.channels), self._device.sensors
        return ToolTrial(
            **vars(exact), mixing=np.zeros((k, 3, 3)), reading=np.zeros((k, 3)), placement=np.zeros((k, 3)),
            strength=1.0, moments=self._moments.copy(), core_radius=0.0, shift=np.zeros(3), place=np.zeros(3),
            turn=np.zeros(3), remanent=np.zeros(3), lag=0.0, turning=np.zeros(3), built=BuiltTrial.exact(),
        )  # fmt: skip

    def wrench_error(self, point: ToolPoint, trial: ToolTrial) -> Array:
        """(3,) along two tangents and the radius [N]."""
        more = np.zeros((self._device.sensors, 3, self._device.channels))
        if self._built is not None and (self._calibrated is not None or point.hall is not None):
            # the uncertainty of a calibration's moments is the noise of its readings, and not a field that it read
            read = isinstance(self._calibrated, CentreFit)
            more = self._built.add_field(trial.built, self._moments if read else trial.moments)
        if isinstance(self._calibrated, CentreFit):
            moments, centres = self._calibrated.find_errors(trial, more)
            trial.moments = (trial.moments - moments) * (1 + trial.gain)
            trial.built.whole -= centres
            if self._built is not None and point.hall is not None:
                more = self._built.add_field(trial.built, trial.moments)
        elif self._calibrated is not None:
            trial.moments = self._calibrated.find_true(trial, more)
        place, turn = trial.place, trial.turn
        currents, extra = np.zeros(self._device.channels), np.zeros(3)
        # Currents depend on the pose, and the pose on readings that include the coils' field: three iterations suffice,
        # and the first pose of a tracker is its last.
        for _ in range(1 if point.hall is None else 3):
            if self._hall is not None and point.hall is not None:
                place, turn = self._locate(self._hall, point, trial, extra, currents, more)
            R = np.empty((3, 3))
            turn_by(float(turn[0]), float(turn[1]), float(turn[2]), point.R, R)
            believed = self._device.wrench_map(
                State(0.0, R, point.p + place, np.zeros(3), np.zeros(3)), self._device.models[0]
            )
            wanted = self._allocator.allocate(believed, point.wrench).currents
            currents = self._loop.true_currents(wanted, trial)
            extra = trial.remanent - self._lag(point, trial, believed.force)
            extra += self._device.core.moment_in(trial.built.earth)
        error: Array = point.R.T @ (self._deliver(point, trial, currents, extra) - point.wrench[:3])
        return error

    def _locate(
        self, hall: HallFit, point: ToolPoint, trial: ToolTrial, extra: Array, currents: Array, more: Array
    ) -> tuple[Array, Array]:
        """(3,) estimated minus true position [m], and rotation from the true to the estimated axis [rad].

        Core and coils are off their place by `trial.shift`, which the tracker does not know: for them, tool and
        sensors are off, the other way.
        """
        assert point.hall is not None
        still = np.zeros(3)
        tool = State(0.0, point.R, point.p - trial.shift, still, still)
        seen_from_core = replace(trial, placement=trial.placement - trial.shift)
        beside = more @ currents + trial.built.earth
        left = hall.read(seen_from_core, tool, trial.strength, trial.moments, extra, currents, beside)
        fit = point.hall.solve @ (left - point.hall.field).ravel()
        return fit[:3], point.R[:, :2] @ fit[3:]

    def _lag(self, point: ToolPoint, trial: ToolTrial, force_per_ampere: Array) -> Array:
        """(3,) deficit of the moment because the force rotates and the core lags [A·m²]."""
        if trial.lag == 0:
            return np.zeros(3)
        force = point.wrench[:3]
        across = trial.turning - force * (trial.turning @ force) / (force @ force)
        across *= self.asked / np.linalg.norm(across)
        both = np.stack([force, across], axis=1)
        moments = trial.moments @ (self._far[:, None] * np.linalg.solve(force_per_ampere, both))
        missing: Array = trial.lag.real * moments[:, 0] + trial.lag.imag * moments[:, 1]
        return missing

    def _deliver(self, point: ToolPoint, trial: ToolTrial, currents: Array, extra: Array) -> Array:
        """(3,) true force [N]: that of the coils and the moment `extra` (3,) [A·m²] is linear in the magnet's strength,
        that of the core quadratic."""
        matrix, passive, still, built = np.empty((6, 3)), np.zeros(6), np.zeros(6), trial.built
        p, per_moment = point.p - trial.shift, np.eye(3)
        from_core = p - built.core
        ring_per_ampere(
            self._rows, self._tables[1], self._pull.nearest, per_moment, from_core, point.R, matrix, passive
        )
        made, x = matrix[:3] @ extra, trial.core_radius / self._span
        if self._wound is None or self._built is None:
            made += matrix[:3] @ trial.moments @ currents
        else:
            terms = [one.terms for one in self._wound]
            more = _interpolate(terms, x) - terms[1]
            rows = self._device.ring_charges
            made += self._built.map(rows, built, trial.moments, more, p, point.R)[:3] @ currents
        table = _interpolate(self._tables, x) + built.softness * self._softer
        pull(table, self._pull.nearest, from_core, np.ascontiguousarray(point.R[:, 2]), still)
        force: Array = trial.strength * made + trial.strength**2 * still[:3]
        return force


def _interpolate(values: Sequence[Array], x: float) -> Array:
    """Parabola through the three `values` at −1, 0 and 1, evaluated at x."""
    low, middle, high = values
    found: Array = middle + 0.5 * x * (high - low) + 0.5 * x * x * (high - 2 * middle + low)
    return found


ESTIMATORS = ("tracker", "hall")
#: number of readings that the Hall tracker's filter averages, at 1 kHz: it passes 0.55 of the noise
_TOOL_SOURCES_AVERAGED = 3.3
#: 1/permeability up to which the core's attraction is interpolated linearly from the file's
_MIN_INVERSE_PERMEABILITY = 1 / 200
#: range of the core's radius in the table, in standard uncertainties; beyond, the parabola extrapolates
_RADIUS_RANGE_SIGMAS = 3.0


def _remanence(core: CoreDynamics, origin: str) -> ErrorSource[ToolTrial]:
    """Remanent moment of the core: uniform along each axis between its maximum values."""

    def perturb(deviates: Array, trial: ToolTrial) -> None:
        most = core.remanent_moment * np.exp(np.log1p(core.spread) * deviates[3])
        trial.remanent += most * (2 * ndtr(deviates[:3]) - 1)

    text = f"{1e3 * core.remanent_moment / np.sqrt(3):.2g} mA·m²"
    return ErrorSource("remanence of the core", text, origin, 4, perturb)


def _eddy_lag(core: CoreDynamics, frequency: float, origin: str) -> ErrorSource[ToolTrial]:
    """Eddy currents in the core, while the force rotates at `frequency` [Hz] in any direction normal to it."""
    turn = 2 * np.pi * frequency

    def perturb(deviates: Array, trial: ToolTrial) -> None:
        share, time = np.exp(np.log1p(core.spread) * deviates[:2])
        x = 1j * turn * time * core.eddy_time
        trial.lag = complex(share * core.eddy_share * x / (1 + x))
        trial.turning = deviates[2:]

    text = f"{100 * core.lag(frequency):.2g} % at {frequency:g} Hz"
    return ErrorSource("eddy currents in the core", text, origin, 5, perturb)


def tool_errors(
    device: SphericalElectromagnet,
    asked: float | None = None,
    estimator: str | None = None,
    calibration: Calibration | None = None,
    frequency: float = 10.0,
) -> ToolErrors:
    """Error model of `device` for forces of `asked` [N]; None: half of the smallest peak force in its shell.

    The force turns at `frequency` [Hz]; 0: it is at rest. With a `calibration` the moments are as uncertain as it says
    and as the field sensors are with which it was made; the gains of the current sensors cancel.

    Raises InputError for a force that the coils cannot give in every direction, UnknownName for another estimator than
    "tracker" and, where the device has field sensors enough, "hall".
    """
    known_estimators = ESTIMATORS if device.sensors > 1 else ESTIMATORS[:1]
    chosen = ESTIMATORS[0] if estimator is None else estimator
    if chosen not in known_estimators:
        raise UnknownName(f"estimator of the error budget of '{device.name}'", chosen, known_estimators)
    believed = device if calibration is None else calibration.apply(device)
    known, core = believed.uncertainty, believed.core_dynamics

    def origin(key: str, section: str = "uncertainty") -> str:
        return find_origin(device, known, key, section)

    weighed = None if calibration is None else calibration.strength_uncertainty
    sources: list[ErrorSource[ToolTrial]] = [
        source("remanence", known.remanence, "1", origin("remanence"), 1, strengthen)
        if weighed is None
        else source("strength of the magnet", weighed, "1", "calibration", 1, strengthen),
        magnet_warmth("temperature of the magnet", device, known),
        *_tool_sources_pose_sources(believed, chosen, calibration),
        source("position of core and coils", known.core_place, "m", origin("core_place"), 3, add_to("shift")),
        # it changes the attraction of the core; the moments are measured with it
        source("radius of the core", known.core_radius, "m", origin("core_radius"), 1, add_to("core_radius")),
        *current_sources(device, known, known.current_offset),
    ]
    computed = believed.moments_from == "windings" and believed.has_sizes and believed.tolerance is not None
    if not computed:  # otherwise by manufacturing errors of the windings
        sources.append(_moments(believed, calibration))
    if believed.tolerance is not None:
        sources += built_sources(believed, believed.tolerance, calibration)
    if core.remanent_moment:
        sources.append(_remanence(core, origin("remanent_moment", "core_dynamics")))
    if core.eddy_share and frequency:
        sources.append(_eddy_lag(core, frequency, origin("eddy_share", "core_dynamics")))
    layers = shell_capability(believed, points=24).layers
    force = choose_size(believed.name, asked, min(min(one.peak_radial, one.peak_tangential) for one in layers), "N")
    made = ToolErrors(
        believed, force, tuple(sources), chosen, _RADIUS_RANGE_SIGMAS * known.core_radius,
        # a calibration with a load cell does not concern the field sensors
        calibration=calibration if weighed is None else None,
        frequency=frequency,
    )  # fmt: skip
    if not believed.has_sizes:
        made.left_out = COILS_AS_POINTS
    return made


def _tool_sources_pose_sources(
    device: SphericalElectromagnet, estimator: str, calibration: Calibration | None
) -> tuple[ErrorSource[ToolTrial], ...]:
    """Error sources of the pose; and of the field sensors, where the moments were measured with them."""
    known, found = device.uncertainty, None if calibration is None else calibration.sensors
    pose: tuple[ErrorSource[ToolTrial], ...] = ()
    if estimator == "tracker":
        pose = _pose_sources(known.place, known.axis, *(find_origin(device, known, key) for key in ("place", "axis")))
    elif found is not None:  # the stated values are norms of errors over all axes
        pose = _pose_sources(found.place / np.sqrt(3), found.axis / np.sqrt(2), "calibration", "calibration")
    if estimator == "tracker" and calibration is None:
        return pose
    standard, origin = device.hall.errors.placement, find_origin(device, known, "placement", "hall")
    placement = source("field sensors, position", standard, "m", origin, 3 * device.sensors, add_to("placement"))
    return (*pose, *sensor_sources(device, device.hall, "hall", _TOOL_SOURCES_AVERAGED), placement)


def _pose_sources(place: float, axis: float, place_origin: str, axis_origin: str) -> tuple[ErrorSource[ToolTrial], ...]:
    """Position [m] and axis [rad] from the tracker."""
    return (
        source("tracked position", place, "m", place_origin, 3, add_to("place")),
        source("tracked axis", axis, "rad", axis_origin, 3, add_to("turn")),
    )


def _moments(device: SphericalElectromagnet, calibration: Calibration | None) -> ErrorSource[ToolTrial]:
    """Moments per ampere, every component of every coil."""
    sizes = np.linalg.norm(device.moment_per_current, axis=0)
    if calibration is not None:
        spread, origin = calibration.uncertainty, "calibration"
        share = float((spread / sizes).max())
    else:
        share, origin = device.uncertainty.moments, find_origin(device, device.uncertainty, "moments")
        spread = np.broadcast_to(share * sizes, (3, device.channels))
    return source("moments per ampere", spread, describe_share(share), origin, spread.size, add_to("moments"))
