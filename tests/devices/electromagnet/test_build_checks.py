"""Only buildable devices are loaded: windings against points drawn in them, each condition violated once."""

from pathlib import Path

import numpy as np
import pytest

from haptorb.cli import main
from haptorb.cli.card import print_card
from haptorb.devices.base import State, rotation_to_axis
from haptorb.devices.build_checks import BuildError
from haptorb.devices.electromagnet import ELECTROMAGNET, find_sensor_field
from haptorb.devices.electromagnet_capability import shell_capability
from haptorb.devices.feasible_wrench import feasible_wrench
from haptorb.devices.loader import catalogue, load, parse
from haptorb.errors import DeviceError
from haptorb.magnetics.magnets import RingMagnet
from haptorb.rotations import rotation_from_euler
from haptorb.simulation.registry import simulate
from haptorb.terminal import make_console
from haptorb_design.problem import BUILD
from oracles import wound_coils

CROSSING = Path(__file__).parent / "files" / "crossing.toml"


def variant(text, *, drop=(), override=False):
    dropped = f"drop = {list(drop)}".replace("'", '"')
    return parse(f'based_on = "omni"\nname = "mine"\n{dropped}\n{text}', "mine", override=override)


def failing(text, drop=()):
    with pytest.raises(BuildError) as refused:
        variant(text, drop=drop)
    return {check.condition for check in refused.value.failures}, str(refused.value)


def points_in(device, k, count, draw):
    """(count, 3) points in winding k, evenly in its volume, about its axis."""
    w = device.windings
    rho = np.sqrt(draw.uniform(w.inner_radius[k] ** 2, w.outer_radius[k] ** 2, count))
    phi, z = draw.uniform(0, 2 * np.pi, count), draw.uniform(-w.length[k] / 2, w.length[k] / 2, count)
    own = np.stack([rho * np.cos(phi), rho * np.sin(phi), z], axis=1)
    axis = device.moment_per_current[:, k] / np.linalg.norm(device.moment_per_current[:, k])
    across = np.linalg.svd(axis[None])[2][1:]
    return own @ np.vstack([across, axis])


def inside(device, k, points):
    w = device.windings
    axis = device.moment_per_current[:, k] / np.linalg.norm(device.moment_per_current[:, k])
    z = points @ axis
    rho = np.sqrt((points**2).sum(axis=1) - z**2)
    return (rho > w.inner_radius[k]) & (rho < w.outer_radius[k]) & (np.abs(z) < w.length[k] / 2)


@pytest.mark.parametrize("name", [name for name in catalogue() if name.startswith("omni")])
def test_no_point_of_a_winding_lies_in_another_in_the_core_or_in_the_dome(name):
    """Drawn in each winding about its own, tilted axis; the check itself compares corners."""
    device, draw = load(name), np.random.default_rng(1)
    for k in range(3):
        points = points_in(device, k, 200_000, draw)
        away = np.linalg.norm(points, axis=1)
        assert away.min() > device.core_radius
        assert away.max() < device.dome_radius - device.dome_wall
        assert not any(inside(device, other, points).any() for other in range(3) if other != k)


def test_the_windings_that_crossed_do_so_and_are_refused():
    device, draw = load(CROSSING, override=True), np.random.default_rng(2)
    assert inside(device, 1, points_in(device, 0, 200_000, draw)).any()
    with pytest.raises(BuildError) as refused:
        load(CROSSING)
    found = [(check.name, 1e3 * check.value, 1e3 * check.limit) for check in refused.value.failures]
    assert ("coil x inside coil y", pytest.approx(24.05, abs=0.005), pytest.approx(22.3)) in found
    assert ("coil y inside coil z", pytest.approx(25.91, abs=0.005), pytest.approx(24.3)) in found
    assert sum("depth" in name for name, *_ in found) == 3  # and 80 turns of enamelled wire do not fit


def test_tilted_coils_meet_where_the_check_says():
    """The greatest distance of a tilted ring's points from the other axis is that of its corner from the centre."""
    device = load("omni")
    draw = np.random.default_rng(3)
    for angle in (0.05, 0.3, 0.8):
        axis = rotation_from_euler(angle, 0.2, 0.0) @ np.array([1.0, 0.0, 0.0])
        points = points_in(device, 1, 400_000, draw)
        if abs(axis @ np.array([0.0, 1.0, 0.0])) > 0.7:
            continue
        away = np.sqrt((points**2).sum(axis=1) - (points @ axis) ** 2)
        corner = float(device.windings.corners[1])
        assert corner * 0.995 < away.max() <= corner


@pytest.mark.parametrize(
    ("text", "drop", "condition", "says"),
    [
        ('[electromagnet]\ncore_radius = "15.7 mm"', (), "windings outside the core", "windings.inner_radius"),
        (
            "[windings]\nturns = [120, 91, 84]", ("coils.resistance",), "wire that fits in layers in its section",
            "6 layers of 23",
        ),
        (
            '[windings]\nturns = [90, 91, 84]\nwire = ["0.71 mm", "0.67 mm", "0.71 mm"]', (),
            "wire with the stated resistance", "instead of 0.6 Ω",
        ),
        (
            '[windings]\nouter_radius = ["18.5 mm", "22.55 mm", "27.25 mm"]', (),
            "windings that cross without touching", "coil x inside coil y",
        ),
        ('[dome]\nwall = "2 mm"', (), "windings inside the dome", "dome.wall"),
        (
            '[coils]\ncurrent_limit = ["26 A", "20 A", "20 A"]', (), "current limits that the supply can drive",
            "drop it",
        ),
        ('[tool]\ntip_distance = "13 mm"', (), "magnet above the dome", "tip_distance"),
        (
            '[hall.positions]\nunit = "mm"\nvalue = [[45, 0, 12], [-55, 0, 0]]', (), "tool clear of the sensors",
            "sensor 1, from its centre to a leaning tool's axis",
        ),
        ('[electromagnet]\ncore_saturation = "0.5 T"', (), "core below its saturation", "core_radius"),
    ],
)  # fmt: skip
def test_each_condition_is_refused_with_numbers_and_what_to_change(text, drop, condition, says):
    conditions, message = failing(text, drop)
    assert condition in conditions
    assert says in message
    assert "override=True" in message
    assert variant(text, drop=drop, override=True).name == "mine"  # for study


def test_a_winding_narrower_than_its_wire_is_refused():
    for drop in ((), ("windings.outer_radius",)):
        with pytest.raises(DeviceError, match=r"windings\.length"):
            variant('[windings]\nlength = ["15.6 mm", "0.5 mm", "18.8 mm"]', drop=drop)


@pytest.mark.parametrize("name", ["omni", "omni-sensor-ring"])
def test_no_pen_that_leans_comes_nearer_to_a_sensor_than_the_check_says(name):
    """Pens drawn at random, their tips on the dome, each as points along its axis."""
    device, draw, count = load(name), np.random.default_rng(5), 60_000
    (check,) = (one for one in device.build_checks if one.condition == "tool clear of the sensors")
    polar = np.arccos(draw.uniform(np.cos(device.workspace_half_angle), 1.0, count))
    polar[: count // 2] = device.workspace_half_angle  # where they come nearest
    around, side = draw.uniform(0, 2 * np.pi, (2, count))
    lean = draw.uniform(0, np.radians(15), count)
    radial = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=1)
    first = np.stack([-np.sin(around), np.cos(around), 0 * around], axis=1)
    away = np.cos(side)[:, None] * first + np.sin(side)[:, None] * np.cross(radial, first)
    axis = np.cos(lean)[:, None] * radial + np.sin(lean)[:, None] * away
    nearest = np.inf
    for along in np.linspace(0.0, 60e-3, 31):
        points = device.dome_radius * radial + along * axis
        for sensor in device.hall.positions:
            nearest = min(nearest, float(np.linalg.norm(points - sensor, axis=1).min()))
    assert nearest == pytest.approx(check.value, rel=0.02)
    assert nearest > 10e-3


@pytest.mark.parametrize("name", ["omni", "omni-sensor-ring"])
def test_no_leaning_tool_and_no_current_takes_a_sensor_out_of_its_range(name):
    """The ring in closed form at 3000 drawn poses in contact; the coils by loops and a core of charges."""
    device, draw = load(name), np.random.default_rng(4)
    magnet = RingMagnet(device.tool.outer_radius, device.tool.inner_radius, device.tool.length, device.tool.remanence)
    at, most = device.hall.positions, np.zeros(device.sensors)
    for _ in range(3000):
        polar, azimuth = np.arccos(draw.uniform(np.cos(device.workspace_half_angle), 1)), draw.uniform(0, 2 * np.pi)
        u = np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
        away = np.cross(u, draw.normal(size=3))
        lean = draw.uniform(0, np.radians(15))
        axis = np.cos(lean) * u + np.sin(lean) * away / np.linalg.norm(away)
        R = rotation_to_axis(axis)
        own = (at - device.dome_radius * u - device.tool.tip_distance * axis) @ R
        most = np.maximum(most, np.abs(magnet.field(own) @ R.T).max(axis=1))

    most += 20.0 * np.abs(wound_coils.coil_fields(device, at)).max(axis=1).sum(axis=1)
    bound = find_sensor_field(device)
    assert (most <= 1.02 * bound).all()
    assert most.max() > 0.8 * bound.max()  # few of the drawn poses are at the edge, leaning to a sensor
    assert bound.max() <= device.hall.range == 0.04


def test_sensors_too_near_for_their_range_are_refused():
    """The ring that a search once found: 51 mm, 11 mm above the centre."""
    ring = [[51e-3 * np.cos(a), 51e-3 * np.sin(a), 11e-3] for a in np.radians(40.0 * np.arange(9))]
    rows = [[f"{1e3 * x:.4f} mm" for x in point] for point in ring]
    conditions, message = failing("[hall]\npositions = " + str(rows).replace("'", '"'))
    assert conditions == {"fields within the sensors' range"}
    assert "hall.range" in message
    wide = '[hall]\nrange = "70 mT"\npositions = ' + str(rows).replace("'", '"')
    assert variant(wide).hall.range == pytest.approx(0.07)


def test_a_simulated_sensor_reads_no_more_than_its_range():
    """The tool's field at the sensors is twice that; quantised, noisy and with an offset it still is."""
    near = variant('[hall]\nrange = "0.5 mT"', override=True)
    simulated = simulate(near, 0)
    simulated.place(np.array([0.0, 0.0, near.contact_distance]), np.array([0.0, 0.0, 0.0, 1.0]))
    readings = np.abs(simulated.sample(0.0, 0.0, True).field)
    assert readings.max() == pytest.approx(0.5e-3, abs=1e-5)


def test_the_flux_in_the_core_is_that_of_the_coils_without_it_three_times_over():
    """Against the winding's own field, by bisected Gauss rules over its sheets; greatest on the equator."""
    device = load("omni")
    check = next(one for one in device.build_checks if one.condition == "core below its saturation")
    radius, total = device.core_radius, 2e-7 * device.tool.moment / (device.contact_distance - device.core_radius) ** 3
    for coil in device.windings.coils:
        inside = np.linspace(0.0, 0.999 * radius, 40)
        fields = np.linalg.norm(coil.field(np.stack([inside, 0 * inside, 0 * inside], axis=1)), axis=1)
        assert fields.argmax() == len(fields) - 1
        total += 20.0 * fields[-1]
    assert check.value == pytest.approx(3 * total, rel=0.02)


def test_what_a_wire_gives_needs_not_be_stated():
    """Resistance by the copper's length, current by the supply, inductance and moments by the windings."""
    dropped = ("coils.resistance", "coils.current_limit", "electromagnet.moment_per_current")
    device = variant("", drop=dropped)
    length = 2 * np.pi * 23 * sum(15.4e-3 + 0.6484e-3 * (n + 0.5) for n in range(4))
    assert device.coils.resistance[0] == pytest.approx(1.7241e-8 * length / (np.pi * 0.3e-3**2), rel=2e-3)
    assert device.coils.current_limit == pytest.approx(12.0 / device.coils.resistance)
    assert device.moments_from == "windings"


def test_omni_has_the_printed_resistance():
    device = load("omni")
    made = [check.value for check in device.build_checks if check.condition == "wire with the stated resistance"]
    assert max(made) < 0.04
    assert device.coils.resistance == pytest.approx(0.6)
    assert (device.dome_radius, device.core_radius) == (0.03, 0.015)


def test_the_card_shows_every_condition_with_its_margin(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["inspect", "omni", "--json"])
    out = capsys.readouterr().out
    device = load("omni")
    for condition in {check.condition for check in device.build_checks}:
        assert condition in out
    with pytest.raises(SystemExit, match="0"):
        main(["inspect", str(CROSSING), "--override"])
    assert "NOT KEPT" in capsys.readouterr().out


def test_a_variant_drops_only_keys_that_its_base_has():
    with pytest.raises(DeviceError, match=r"'windings\.wires'"):
        variant("", drop=("windings.wires",))
    with pytest.raises(DeviceError, match="list of keys"):
        parse('based_on = "omni"\nname = "mine"\ndrop = "windings"', "mine")
    with pytest.raises(DeviceError, match="no based_on"):
        parse(f'kind = "{ELECTROMAGNET.name}"\nname = "mine"\ndrop = ["windings"]', "mine")
    assert variant("", drop=("marks",)).marks is None


def test_a_fill_takes_the_place_of_the_bases_wire():
    """Files of variants that stated it go on working: the wire of the base is not theirs."""
    device = variant("[windings]\nfill = 0.65", drop=("coils.current_limit",))
    assert device.windings.wire is None
    assert device.coils.resistance == pytest.approx([coil.resistance(0.65) for coil in device.windings.coils], rel=1e-3)
    with pytest.raises(DeviceError, match="wire and fill"):
        variant('[windings]\nfill = 0.65\nwire = ["0.6 mm", "0.67 mm", "0.67 mm"]')


@pytest.mark.parametrize("name", catalogue())
def test_every_condition_fits_into_the_column_of_a_results_database(name):
    """`refused_by` has 64 characters; PostgreSQL refuses more."""
    for check in load(name, override=True).build_checks:
        assert len(f"{BUILD}: {check.condition}") <= 64


def test_the_card_says_how_each_coil_is_wound(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["inspect", "omni"])
    out = " ".join(capsys.readouterr().out.split())
    length = 2 * np.pi * 23 * sum(15.4e-3 + 0.6484e-3 * (n + 0.5) for n in range(4))
    ohms = 1.7241e-8 * length / (np.pi * 0.3e-3**2)
    said = f"92 turns of 0.6 mm wire, 0.648 mm with its enamel: 4 layers of 23, {length:.3g} m, "
    assert float(out.partition(said)[2].split()[0]) == pytest.approx(ohms, rel=2e-3)


def test_no_peak_is_more_than_the_supply_drives_and_the_card_shows_the_hot_current(capsys):
    """A limit of 24 A over 12 V and 0.6 Ω: peaks are those of 20 A. Hot: 12 V / (0.6 Ω (1 + 0.00393 · 75))."""
    loose = variant('[coils]\ncurrent_limit = ["24 A", "24 A", "24 A"]\n[supply]\npower = "2 kW"')
    tight = variant('[supply]\npower = "2 kW"')
    top = State.at((0.0, 0.0, 0.05))
    assert feasible_wrench(loose, top).guaranteed_force == pytest.approx(feasible_wrench(tight, top).guaranteed_force)
    for one, other in zip(
        shell_capability(loose, points=5).layers, shell_capability(tight, points=5).layers, strict=True
    ):
        assert one.peak_radial == pytest.approx(other.peak_radial)
    with pytest.raises(SystemExit, match="0"):
        main(["inspect", "omni"])
    assert f"20 A peak at 20 °C, {20 / (1 + 0.00393 * 75):.3g} A hot" in " ".join(capsys.readouterr().out.split())
    print_card(load("pmsm"), make_console(), ())  # 60 V over 45.5 Ω: 1.02 A at 95 °C
    assert "1 A peak at 20 °C and hot, 0.2" in " ".join(capsys.readouterr().out.split())
