"""Heat observer against true networks within the tolerance: its estimate is never too low."""

from dataclasses import replace

import numpy as np
import pytest

from haptorb.control.guard import make_coils, make_state
from haptorb.control.heat import observe_heat
from haptorb.control.protection import Protection
from haptorb.devices.loader import load

from .protected import FRESH, PUSH, sample

OMNI = load("omni")
HEAT = OMNI.coils.heat
AMBIENT = HEAT.ambient
ROUGHLY = 0.05  #: what noise and finite steps may make [K]


def corner(seed):
    """A network with every value at one end of the tolerance, or (seed 0, 1) all at the same end."""
    draw, network = np.random.default_rng(seed), HEAT.network(3)

    def shift(values):
        signs = np.full(values.shape, 2 * seed - 1.0) if seed < 2 else draw.choice((-1.0, 1.0), values.shape)
        return values * (1 + HEAT.tolerance * signs)

    between = np.triu(shift(network.exchange))
    return replace(
        network, capacity=shift(network.capacity), exchange=between + between.T, to_air=shift(network.to_air)
    )


class True3:
    """Three coils as they really are: rises of all nodes, and currents held for a step."""

    def __init__(self, network, dt):
        self.step, self.rises = network.step(dt), np.zeros(network.nodes)

    def go(self, currents):
        power = currents**2 * OMNI.coils.resistance_at(AMBIENT + self.rises[:3])
        self.rises = self.step @ np.concatenate([self.rises, power])

    @property
    def winding(self):
        return AMBIENT + self.rises[:3]

    @property
    def body(self):
        return AMBIENT + self.rises[3:6]


def loads(seed, steps):
    """(n, 3) currents [A]: each coil on and off by itself, for seconds to minutes."""
    draw = np.random.default_rng(seed)
    hold = draw.integers(50, 2000, 60)
    return np.repeat(draw.uniform(0, 9, (60, 3)) * (draw.random((60, 3)) < 0.5), hold, axis=0)[:steps]


def observe(device, network, currents, dt=0.02):
    """(n, 3) observed and true winding temperatures while `currents` (n, 3) flow."""
    state, coils, truth = make_state(device, dt), make_coils(device), True3(network, dt)
    out = np.empty((2, len(currents), 3))
    for n, amperes in enumerate(currents):
        truth.go(amperes)
        coils["current"], coils["boundary"] = amperes, truth.body
        observe_heat(state["heat"][0], coils, dt)
        out[:, n] = coils["winding"], truth.winding
    return out


@pytest.mark.parametrize("seed", range(8))
def test_never_below_the_true_temperature(seed):
    observed, true = observe(OMNI, corner(seed), loads(seed, 8000))
    assert (observed >= true - ROUGHLY).all()
    assert true.max() > AMBIENT + 15  # it was warm
    assert (observed - true).max() < 0.35 * (true.max() - AMBIENT)  # and not for being far above


def test_with_exact_values_it_is_the_true_temperature():
    device = replace(OMNI, coils=replace(OMNI.coils, heat=replace(HEAT, tolerance=0.0)))
    observed, true = observe(device, HEAT.network(3), loads(3, 8000))
    assert np.abs(observed - true).max() < 0.02 * (true.max() - AMBIENT)


def test_uncoupled_values_would_miss_what_the_neighbours_give():
    """Two coils are driven; the third gets its heat through the core only, unseen without a core."""
    currents = np.tile([8.0, 8.0, 0.0], (8000, 1))
    blind = replace(OMNI, coils=replace(OMNI.coils, heat=replace(HEAT, coupling=None)))
    observed, true = observe(OMNI, HEAT.network(3), currents)
    missed, _ = observe(blind, HEAT.network(3), currents)
    assert (observed[-1] >= true[-1]).all()
    assert missed[-1, 2] < true[-1, 2] - 5.0


@pytest.mark.parametrize("seed", range(3))
def test_the_guard_keeps_every_true_winding_below_the_stop(seed):
    """Full current asked of one, two or all coils for two minutes, the thermometers reading the true bodies."""
    dt, now = 0.01, 0.0
    protection, truth = Protection(OMNI, dt), True3(corner(seed), dt)
    wanted = 20.0 * np.array([(1, 0, 0), (1, 1, 0), (1, 1, 1)][seed % 3])
    hottest = 0.0
    for tick in range(12_000):
        protection.protect_wrench(PUSH, FRESH, now)
        if tick == 0:
            protection.engage()
        held = protection.coils["current_commanded"].copy()
        truth.go(held)
        state = protection.coils
        volts = held * state["cold"] * (1 + state["coefficient"] * (state["winding"] - state["reference"]))
        protection.protect_currents(wanted, FRESH, sample(held, truth.body), volts / 12.0)
        now += dt
        hottest = max(hottest, float(truth.winding.max()))
    assert protection.engaged, protection.reason
    assert HEAT.derate - 12.0 < hottest < HEAT.stop


def test_the_time_that_is_left_counts_the_neighbours():
    """One coil at 9 A, with the others cold and with the others at 9 A: the observer counts down what then happens."""
    left = []
    for others in (0.0, 9.0):
        state, coils = make_state(OMNI, 0.02), make_coils(OMNI)
        network, currents = HEAT.network(3), np.array([9.0, others, others])
        truth = True3(network, 0.02)
        for _ in range(400):
            truth.go(currents)
            coils["current"], coils["boundary"] = currents, coils["body"] if coils["body"].any() else truth.body
            observe_heat(state["heat"][0], coils, 0.02)
        predicted, ticks = float(state["heat"]["remaining"][0]), 0
        while coils["winding"].max() < HEAT.derate and ticks < 20_000:
            coils["current"], coils["boundary"] = currents, coils["body"]
            observe_heat(state["heat"][0], coils, 0.02)
            ticks += 1
        assert predicted == pytest.approx(0.02 * ticks, rel=0.02)
        left.append(predicted)
    assert left[1] < 0.9 * left[0]


def test_a_device_that_is_switched_on_warm_has_a_warm_core():
    state, coils = make_state(OMNI, 0.02), make_coils(OMNI)
    coils["boundary"] = np.array([320.0, 330.0, 310.0])
    observe_heat(state["heat"][0], coils, 0.02)
    assert state["heat"]["core"][0] == pytest.approx(330.0, abs=0.1)
    assert coils["winding"] == pytest.approx(coils["boundary"], abs=0.1)
