"""The common part of every device: coils that heat up, a supply, limits, and a wrench map."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeVar

import numpy as np

from haptorb.devices.device_text import DeviceText
from haptorb.devices.kind import DeviceKind, load_part
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.display.presentable import Presentable
from haptorb.display.quantity_text import format_number, format_quantity
from haptorb.errors import InputError, UnknownName
from haptorb.numerics.arrays import Array
from haptorb.physics.thermal import TwoNode
from haptorb.physics.thermal_network import ThermalNetwork

__all__ = ["Coils", "Device", "Heat", "HeatCoupling", "Limits", "Shell", "Supply", "require"]


@dataclass(frozen=True)
class HeatCoupling:
    """Thermal coupling between channels: one core, or former, between their windings."""

    core_capacity: float  #: [J/K]
    winding_to_core: tuple[float, ...]  #: (m,) conductance of each winding [W/K]


@dataclass(frozen=True)
class Heat:
    """Two bodies in series per channel, winding → body → air, equal for all channels; and their thermal coupling.

    One time constant cannot reproduce the published endurances (Zárate 2020 §III and §V); two can.
    """

    winding_capacity: float  #: [J/K]
    body_capacity: float  #: [J/K]
    winding_to_body: float  #: conductance [W/K]
    body_to_air: float  #: conductance [W/K]
    ambient: float  #: [K]
    warn: float  #: winding temperature at which the user is warned [K]
    derate: float  #: from here currents are reduced [K]
    stop: float  #: here the coils go off [K]
    coupling: HeatCoupling | None = None  #: None: no channel warms another
    tolerance: float = 0.0  #: relative: how far capacities and conductances may be off

    @property
    def coil(self) -> TwoNode:
        """Winding and body of one channel, without the coupling to others."""
        return TwoNode(self.winding_capacity, self.body_capacity, self.winding_to_body, self.body_to_air)

    def network(self, channels: int) -> ThermalNetwork:
        """All `channels` and their coupling: nodes are the windings, the bodies and, if there is one, the core."""
        coupling = self.coupling
        if coupling is None:
            return ThermalNetwork.of_coils(self.coil, np.zeros(channels), 1.0)
        return ThermalNetwork.of_coils(self.coil, coupling.winding_to_core, coupling.core_capacity)


@dataclass(frozen=True)
class Coils:
    """Electrical data of the channels; arrays have one entry per channel."""

    names: tuple[str, ...]
    resistance: Array  #: (m,) at the reference temperature [Ω]
    inductance: Array  #: (m,) [H]
    current_limit: Array  #: (m,) greatest magnitude that may be commanded [A]
    temperature_coefficient: float  #: relative resistance change per kelvin [1/K]
    reference_temperature: float  #: [K]
    heat: Heat

    def resistance_at(self, temperature: Array) -> Array:
        """(m,) resistance [Ω] at winding `temperature` (m,) [K]."""
        warm: Array = self.resistance * (1 + self.temperature_coefficient * (temperature - self.reference_temperature))
        return warm


@dataclass(frozen=True)
class Supply:
    """The supply of the coils: a voltage, chopped in steps, and its current sensor."""

    voltage: float  #: [V]
    duty_bits: int  #: resolution of the duty cycle's magnitude
    current_noise: float  #: standard deviation of one current reading [A]
    current_step: float  #: quantum of one current reading [A]
    power: float = np.inf  #: greatest power that it gives to all channels together [W]


CONTACT_RATE = 150.0  #: of the force of a contact of 500 N/m that a hand meets at 0.3 m/s [N/s]
HANDOVER = 0.02  #: in which the greatest force of a device can fade to zero [s]


@dataclass(frozen=True)
class Limits:
    """Limits that the guard enforces, for the mover as a whole and for every channel."""

    force: float  #: greatest magnitude asked of the device [N]
    torque: float  #: greatest magnitude asked of the device [N·m]
    slew: float  #: maximum slew rate of a channel's current [A/s]
    expiry: float  #: age at which a command or a pose is worth nothing [s]
    force_rate: float  #: greatest rate of a client's force, and of the force while another world takes over [N/s]
    torque_rate: float  #: the same of torque [N·m/s]


@dataclass(frozen=True)
class Shell:
    """The space above a dome in which a tool's magnet can be."""

    contact_distance: float  #: of the magnet from the dome's centre when a radial tool touches the dome [m]
    thickness: float  #: height above contact up to which forces are rendered [m]
    moment: float  #: of the tool's magnet [A·m²]
    dome_radius: float  #: outside of the dome [m]


@dataclass(frozen=True, kw_only=True)
class Device(Presentable, ABC):
    """Frozen data of one device; built by the loader from a file, or in Python."""

    kind: ClassVar[DeviceKind]  #: what programs do differently for devices of this class

    name: str
    title: str
    source: str
    coils: Coils
    supply: Supply
    limits: Limits
    assumed: Mapping[str, str]  #: value → reason, for values that the source does not give
    digest: str  #: of everything in the file: recordings and calibrations name their device by it

    #: the models of coils and magnets that `wrench_map` knows, the default first
    models: tuple[str, ...] = ()

    #: what it was built from, if that was a file
    text: DeviceText | None = field(default=None, repr=False, compare=False)

    @property
    def tick_models(self) -> tuple[str, ...]:
        """Those of `models` that are fast enough for a servo. By default the first."""
        return self.models[:1]

    @property
    def channels(self) -> int:
        """Number of commanded currents."""
        return len(self.coils.names)

    @property
    def sensors(self) -> int:
        """Number of three-axis field sensors on the stator."""
        return 0

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks about inconsistent values of this device: sentences."""
        return ()

    @property
    def shell(self) -> Shell | None:
        """Where a tool can be above a dome; None for a device without a dome."""
        return None

    @property
    def is_upright(self) -> bool:
        """Whether a tool is upright if no orientation is given; else its axis is radial."""
        return False

    @property
    def rest_position(self) -> Array:
        """(3,) rest position of the mover: a position at which every model of the device is valid [m]."""
        return np.zeros(3)

    @abstractmethod
    def wrench_map(self, state: State, model: str) -> WrenchMap:
        """The wrench map at `state`, by one of `models`."""

    def draw(self, view: str = "both", azimuth: float = 0.0) -> Any:
        """A matplotlib figure: the drawing to scale that `haptorb show` writes; `view` is "section", "3d" or "both".

        The section's plane contains z and is turned by `azimuth` [°] from +x towards +y. `figure.savefig(path)` stores
        the figure; a notebook shows it. Raises InputError for a kind of device without geometry.
        """
        return load_part("haptorb.apps.show.drawing:draw_device")(self, view, azimuth)

    def check_model(self, model: str) -> str:
        """`model` itself. Raises UnknownName with the models of this device."""
        if model not in self.models:
            raise UnknownName(f"model of device '{self.name}'", model, self.models)
        return model

    def check_tick_model(self, model: str) -> str:
        """`model` itself; UnknownName for no model of this device, InputError for one that takes longer than a tick."""
        if self.check_model(model) not in self.tick_models:
            raise InputError(
                f"model '{model}' of device '{self.name}' takes too long for a tick; a servo can use: "
                f"{', '.join(self.tick_models)}"
            )
        return model

    def _summarize(self) -> str:
        amperes = format_quantity(float(self.coils.current_limit.max()), "A")
        limits = f"{format_quantity(self.limits.force, 'N')}, {format_quantity(self.limits.torque, 'N·m')}"
        parts = f"{self.channels} channels to {amperes}, {self.sensors} field sensors, limits {limits}"
        return f"<{type(self).__name__} {self.name!r}: {parts}>"

    def _list_facts(self) -> list[tuple[str, str]]:
        """What every device has; kinds add theirs."""
        coils, heat, limits = self.coils, self.coils.heat, self.limits
        few = self.channels <= 6
        names = ", ".join(coils.names) if few else f"{coils.names[0]} to {coils.names[-1]}"
        peak, lasting = float(coils.current_limit.max()), float(self.sustained_current.min())
        together = float(self.sustained_current_together.min())
        continuous = f"{format_quantity(lasting, 'A')} continuous"
        if heat.coupling is not None:
            continuous += f" in one coil, {format_quantity(together, 'A')} in all"
        power = "" if np.isinf(self.supply.power) else f", {format_quantity(self.supply.power, 'W')}"
        ohms = f"{format_number(float(coils.resistance.min()))} Ω at {coils.reference_temperature - 273.15:.0f} °C"
        return [
            ("title", self.title),
            ("source", self.source),
            ("channels", f"{self.channels} ({names})"),
            ("current", f"{format_quantity(peak, 'A')} peak, {continuous}"),
            ("coils", f"{ohms}, {format_quantity(float(coils.inductance.min()), 'H')}"),
            (
                "temperatures",
                f"currents reduced from {heat.derate - 273.15:.0f} °C, off at {heat.stop - 273.15:.0f} °C",
            ),
            ("supply", f"{format_quantity(self.supply.voltage, 'V')}{power}, {self.supply.duty_bits} bits of duty"),
            (
                "limits",
                f"{format_quantity(limits.force, 'N')}, {format_quantity(limits.torque, 'N·m')}, "
                f"{format_quantity(limits.slew, 'A/s')}, clients {format_quantity(limits.force_rate, 'N/s')}, "
                f"{format_quantity(limits.torque_rate, 'N·m/s')}, poses expire after "
                f"{format_quantity(limits.expiry, 's')}",
            ),
            ("field sensors", f"{self.sensors}, three axes each"),
            ("models", ", ".join(self.models)),
            ("assumed", f"{len(self.assumed)} values that the source does not state, see `.assumed`"),
            ("digest", self.digest[:12]),
        ]

    @property
    def driven_current(self) -> Array:
        """(m,) largest current that supply and limit allow, with the coils at their reference temperature [A]."""
        driven: Array = np.minimum(self.coils.current_limit, self.supply.voltage / self.coils.resistance)
        return driven

    @property
    def greatest_resistance(self) -> Array:
        """(m,) resistance of windings at the stop temperature, the maximum with current [Ω]."""
        return self.coils.resistance_at(np.full(self.channels, self.coils.heat.stop))

    @property
    def sustained_current(self) -> Array:
        """(m,) continuous current of a channel alone: its winding settles at the derating temperature
        [A]."""
        rise_per_ampere2 = np.diagonal(self._rise_per_ampere2)
        current: Array = np.minimum(np.sqrt(self._greatest_rise / rise_per_ampere2), self.coils.current_limit)
        return current

    @property
    def sustained_current_together(self) -> Array:
        """(m,) the same continuous current in all channels: the hottest winding settles at the derating temperature
        [A].

        At most `sustained_current`; equal to it without thermal coupling between equal channels.
        """
        hottest = float(self._rise_per_ampere2.sum(axis=1).max())
        current: Array = np.minimum(np.sqrt(self._greatest_rise / hottest), self.coils.current_limit)
        return current

    @property
    def _greatest_rise(self) -> float:
        return self.coils.heat.derate - self.coils.heat.ambient

    @property
    def _rise_per_ampere2(self) -> Array:
        """(m, m) [K/A²] steady rise of each winding (row) for the square of the current in each channel (column).

        All resistances as at the derating temperature: no winding is warmer, and few are as warm.
        """
        coils = self.coils
        rise: Array = coils.heat.network(self.channels).rise_per_watt * coils.resistance_at(
            np.full(self.channels, coils.heat.derate)
        )
        return rise


D = TypeVar("D", bound=Device)


def require(device: Device, of: type[D], what: str) -> D:
    """`device`, for a program `what` that supports only class `of`. Raises InputError for another.

    If several kinds support something in different ways, use a part of their records instead.
    """
    if not isinstance(device, of):
        raise InputError(f"device '{device.name}' is a {device.kind.title}; {what} works for {of.kind.title}s")
    return device
