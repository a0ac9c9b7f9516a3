"""Every table as displayed: all numbers, units and headings of the source, uncut, at any width."""

import io
import json
import re
import sys
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from rich.cells import cell_len
from rich.console import Console

from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.terminal import TextTable

WIDTHS = (80, 120, 38)


def omni_card():
    from haptorb.cli.electromagnet_card import ElectromagnetCard
    from haptorb.devices.electromagnet_capability import Layer, ShellCapability
    from haptorb.devices.feasible_wrench import FeasibleWrench

    card = object.__new__(ElectromagnetCard)
    card._device = load("omni")
    forces = (1.1752, 0.5221, 0.2794, 0.1243, 0.1925, 0.0856)
    layers = tuple(Layer(d, *forces, 0.0529, 0.1562, 0.32) for d in (0.050, 0.070))
    card._capability = ShellCapability(layers, ((1.0, 4.2), (0.25, 668.0), (0.2, float("inf"))))
    able = FeasibleWrench(np.zeros((8, 3)), np.zeros((8, 3)), np.zeros((4, 3)), np.array([0.5, 0, 0.87]), 0.522, 0.0098)
    card._feasible_wrenches = [(State.at((0.0, 0.0, 0.05)), able)]
    card._predicted = np.diag([0.1875, 0.2045, 0.2242])
    return card.show, ["[mm]", "[mN]", "[mN·m]", "[°]", "[JND]", "[m²]", "1175", "522", "279", "124", "192", "86",
                       "52.9", "15.6", "2.2", "+0.1875", "tangential", "668 s"]  # fmt: skip


def pmsm_card():
    from haptorb.cli.motor_card import MotorCard
    from haptorb.control.capability import MotorCapability

    card = object.__new__(MotorCard)
    card._device = load("pmsm")
    grid = np.full((2, 2, 3), 1.234)
    flat = np.full((2, 2), 7.77)
    shares = np.full((3, card._device.channels), 0.125)
    card._capability = MotorCapability(np.zeros(2), 4, grid, 0.1 * grid, flat, flat, 100 * grid, shares)
    card._endurance = ((1.0, 12.0), (0.5, float("inf")))
    card._righting_torques = np.full((4, 3), 0.217)
    return card.show, ["[N·m]", "[W]", "[%]", "1.23", "0.123", "+EM1", "−EM13", "7.77", "0.217"]


def bench():
    from haptorb_bench.result import BenchResult, Metric

    rows = (
        Metric("magnetics", "torque per ampere of all 24 coils", 6.89, "µs", "magpylib, core in blocks", 55300.0,
               note="errors 8e-10 and 5e-04"),
        Metric("recording", "rows written per second (MCAP, zstd)", 64702.0, "1/s", "plain float64", 1452678.0, 1000.0,
               at_least=True, note="a plain file is neither compressed nor self-describing, [and] has no :BUS: in it"),
        Metric("recording", "late", None, "1"),
    )  # fmt: skip
    made = BenchResult({"processor": "Xeon [tm]", "cores": "2"}, "haptorb bench", "2026-01-01", rows)
    return made.show, ["6.89 µs", "55.3 ms", "64,702 1/s", "1,452,678 1/s", "≥ 1,000 1/s", "8,026 ×", "8e-10", "[tm]"]


def contest():
    from haptorb_bench.contest import Contest, Result

    results = (
        Result("torque [N·m] of all coils", "haptorb", "exact to 1e-7", 2.6e-6, 1e-7),
        Result("torque [N·m] of all coils", "magpylib", "getFT, one batch, and a long way to say so", 0.138, 8e-4),
        Result("torque [N·m] of all coils", "cfsem", "loops", None, None),
    )
    made = Contest("A contest [of two]", results, {"cores": "2"})
    return made.show, ["[N·m]", "2.60 µs", "138 ms", "8.0e-04", "53,077", "not installed", "[of two]"]


def estimators():
    from haptorb_papers.estimators.comparison import EstimatorComparison, EstimatorRow, print_comparison

    rows = tuple(
        EstimatorRow(estimator, disturbance, 0.02134, 1.456e-07, 0.00312, 0.0214, 3.6, angle, 0.125)
        for disturbance in ("ideal sensors", "noise 0.1 mT", "a sensor that reads zero")
        for estimator, angle in (("network", np.nan), ("linear", np.nan), ("least-squares", 0.0021))
    )
    times = {name: {"median": 24.9, "p95": 43.1} for name in ("network", "linear", "least-squares")}
    made = EstimatorComparison("pmsm", 17, rows, None, times)
    return lambda console: print_comparison(made, console), [
        "[%]", "[mN·m/A]", "[mN·m]", "[JND]", "[°]", "1.46e-05", "not estimated", "0.0021", "25 µs",
    ]  # fmt: skip


def fit():
    from haptorb.cli.multipole_comparison import FitComparison
    from haptorb.magnetics.multipole_fit import MultipoleFit

    model = SimpleNamespace(loop_strengths=np.array([0.25, 1.5]), per_loop=12, dipoles=41, pole_distance=0.0064)
    body = SimpleNamespace(length=0.0127)
    one = MultipoleFit(model, 0.01234, 0.0345)
    made = FitComparison("pmsm", "magnet", body, one, one, (0.0, 0.01))
    return made.show, [
        "[%]",
        "1.234",
        "3.450",
        "0.504",
        "[magnets.multipole]",
        "strengths = [0.25, 1.5]",
        "in the file",
    ]


def train():
    from pathlib import Path

    from haptorb.cli.training import Training

    told = {"electromagnets": [1, 16], "inputs": 27, "samples": 16200, "iterations": 113,
            "rms_of_standardised_outputs": 0.0234}  # fmt: skip
    judged = {"workspace": 0.0213, "figure_4": 0.0227, "all_coils": 0.0242, "electromagnet": 17}
    record = {"networks": [told], "judged": judged, "seconds": 30.0, "peak_megabytes": 328.0}
    made = Training(SimpleNamespace(record=record), Path("/a/folder/with a name [x]/networks.npz"))
    return made.show, ["[%]", "2.34", "2.13 %", "16200", "[x]", "328 MB"]


def fitness():
    from haptorb.cli.check_computer import print_fitness

    report = {"device": "omni", "rate_hz": 1000.0, "ticks": 30000, "missed": 3,
              "ahead_us": {"p50": 5.0, "p99": 9.0}, "lateness_us": {"p50": 12.0, "p99": 153.0, "p999": None},
              "compute_us": {"a": 59.0, "b": 149.0, "c": 310.0},
              "scheduler": {"policy": "SCHED_FIFO:[80]"}}  # fmt: skip
    verdicts = (SimpleNamespace(what="lateness, 99 %", measured="153 µs", wanted="at most 150 µs", fit=False),)
    made = SimpleNamespace(
        report=report, took=SimpleNamespace(others=0.2, stolen=0.013, preempted=7), duration=30.0, dragging=True,
        machine=SimpleNamespace(processor="Xeon", cores=2, virtual=True, kernel="6.18 #1 SMP [PREEMPT]"),
        verdicts=verdicts, fit=False, advice=("Set `rtprio` [limits.conf] to 80.",),
    )  # fmt: skip
    return lambda console: print_fitness(made, console), [
        "[µs]", "99.9 %", "153 µs", "150 µs", "[PREEMPT]", "SCHED_FIFO:[80]", "[limits.conf]", "310",
    ]  # fmt: skip


def world():
    from haptorb.cli.check_world import print_world

    made = SimpleNamespace(
        device="omni", world="dome", passive=False, verdict="outside", margin=0.5, largest=812.5,
        setting=SimpleNamespace(tracker_rate=240.0, bandwidth=None, rate=1000.0, latency=0.004, grip="light",
                                hand=SimpleNamespace(mass=0.1, damping=2.0, stiffness=50.0)),
        loop=SimpleNamespace(period=0.001, lateness=0.0052, delay_bound=lambda b: 345.6,
                             passive_bound=lambda b: 4000.0),
        steep=SimpleNamespace(stiffness=1625.0, away=12.5, damping=0.75, jump=0.05),
        hand=SimpleNamespace(damping=2.0), place=SimpleNamespace(force="N", length="m"), part=None, turning=None,
        unjudged=(), advice=("Use a tracker [of] 480 Hz.",),
    )  # fmt: skip
    return lambda console: print_world(made, console), [
        "[N/m]", "1625", "812.5", "345.6", "4000", "12.5", "N·s/m", "50 mN", "2 times too strong", "[of]",
    ]  # fmt: skip


def study(text, **parts):
    from haptorb_study.analysis.analysis import Analysis
    from haptorb_study.analysis.tables import print_summary
    from haptorb_study.study_file import study_of

    made = Analysis(study_of(text), 6, 120, 12, 6, 0, **parts)
    assert json.dumps(made.numbers(), allow_nan=False)
    return lambda console: print_summary(made, console)


def identification():
    from haptorb_study.analysis.comparison import ConditionComparison
    from haptorb_study.analysis.confusion import Arrow, Confusion
    from haptorb_study.analysis.error_by_latitude import LatitudeError

    points = "".join(f"{{ number = {n}, theta_deg = {6 * n}, phi_deg = 45 }}," for n in range(1, 10))
    square = np.full((9, 9), 0.1)
    confusion = Confusion(tuple(range(1, 10)), 8 * square, square + 0.613 * np.eye(9),
                          np.tile([0.614, 0.805], (9, 1)), 0.713, (0.652, 0.771), (np.nan, np.nan), 1 / 9,
                          3e-12)  # fmt: skip
    show = study(
        f'name = "places"\n[set_points]\npoints = [{points}]\n[trials]\nrepetitions = 2\n',
        confusion=confusion, arrows=(Arrow(3, 4, 12, 0.58), Arrow(3, 5, 12, 0.42)),
        rings=(LatitudeError(36.0, 40, 12.34, 3.21, 10.5, 14.2),),
        comparisons=(ConditionComparison("error", "mm", "strong", "weak", -12.23, -15.1, -9.44, 6, 0.03125),),
    )  # fmt: skip
    return show, ["[%]", "[mm]", "71.3 %", "65.2 to 77.1 %", "3e-12", "4 (7 of 12)", "12.34", "10.50 to 14.20",
                  "error [mm]", "-12.2", "-15.1 to -9.44", "0.0312", "strong − weak"]  # fmt: skip


def curves():
    from haptorb_study.analysis.curves import ConditionCurves
    from haptorb_study.statistics.population import NormalEffect, Population
    from haptorb_study.statistics.psychometric_fit import PersonFit
    from haptorb_study.statistics.psychometric_function import LevelCounts, PsychometricCurve

    fit = PersonFit(180, PsychometricCurve(2.345, 0.4567, 0.02, 0.02), (2.2, 2.5), (0.4, 0.51), (0.001, 0.06),
                    (0.001, 0.06), 5.4, 0.37, ("too few trials for the spread",))  # fmt: skip
    group = Population(6, NormalEffect(2.41, (2.307, 2.513), 0.0831, (0.0, 0.217)),
                       NormalEffect(-0.8, (-0.9, -0.7), 0.1, (0.0, 0.3)), 0.0171)  # fmt: skip
    answered = LevelCounts(np.array([1.5, 2.5]), np.array([[4.0, 80]]), np.array([[90.0, 90]]))
    show = study(
        'name = "c"\nprocedure = "constant"\n[levels]\nparameter = "moment"\nreference = 2.0\nvalues = [1.5, 2.5]\n',
        curves={"base": ConditionCurves(answered, {"P01": fit}, group)}, notes=("condition 'weak': no answers yet",),
    )  # fmt: skip
    return show, ["[A·m²]", "2.345", "2.2 to 2.5", "0.308", "2.41", "2.307 to 2.513", "0.0831", "0 to 0.217",
                  "factor 1.11", "0.37", "no answers yet", "P01: too few trials for the spread"]  # fmt: skip


def tracks():
    from haptorb_study.analysis.tracks import ConditionTracks, TrackFit
    from haptorb_study.statistics.population import NormalEffect

    people = {"P01": TrackFit(60, True, 0.3214, 0.3187, (0.25, 0.3999)),
              "P02": TrackFit(60, True, 0.41, 0.4, (0.31, 0.52))}  # fmt: skip
    show = study(
        'name = "c"\nprocedure = "staircase"\n[levels]\nreference = 1.2\nleast = 0.01\nmost = 1.0\nstart = 0.8\n',
        tracks={"base": ConditionTracks(people, NormalEffect(-1.5, (-1.8, -1.2), 0.2, (0.0, 0.7)))},
    )  # fmt: skip
    return show, ["[A·m²]", "0.3214", "P02", "0.3187", "0.25 to 0.3999", "0.3536", "0.2872 to 0.4353"]


def ratings():
    from haptorb_study.analysis.comparison import RatingMean

    show = study(
        'name = "r"\nprocedure = "rating"\n',
        scores={"base": RatingMean(4.25, 1.5, 24, 3.5, 5.01)}, chosen={("a", "b"): (9, 12, (0.47, 0.91))},
    )  # fmt: skip
    return show, ["4.25", "3.50 to 5.01", "1.50", "24", "a over b", "9 of 12", "47.0 to 91.0", "[%]"]


def tetrahedron_card():
    from haptorb.cli.array_card import CoilArrayCard
    from haptorb.control.capability import ArrayLayer, ContactForces

    card = object.__new__(CoilArrayCard)
    card._device = load("tetrahedron")
    card._layers = (ArrayLayer(0.0125, np.array([1.2345, 0.6789, 0.4321]), 0.1 * np.ones(3), 0.3579, 0.0246, 13.57),)
    card._endurance = ((1.0, 4.2), (0.2, float("inf")))
    card._contact = ContactForces(np.array([-0.0137, 0.0137]), np.zeros(1), np.array([[0.0222, 0.0468]]))
    return card.show, [
        "12.5",
        "1234",
        "679",
        "432",
        "100",
        "358",
        "25",
        "13.6",
        "[mm]",
        "[mN]",
        "[W]",
        "20 % unlimited",
    ]


def guidance():
    from haptorb_papers.guidance.comparison import GuidanceComparison, GuidanceRow
    from haptorb_papers.guidance.show import print_guidance

    rows = tuple(GuidanceRow("circle", "light", way, 0.001234, 0.00567, 0.0891, 12.34, 1.0, 0.002, 0.003, way == "plan")
                 for way in ("none", "valley", "spring", "plan"))  # fmt: skip
    drift = {("light", way): 0.00778 for way in ("none", "valley", "plan")}
    made = GuidanceComparison("omni", 20.0, 1, "exact", rows, drift, {})
    return lambda console: print_guidance(made, console), [
        "[mm]", "[N]", "[W]", "1.234", "5.67", "0.089", "12.3", "plan (tripped)", "7.78", "1.00", "20 s each",
    ]  # fmt: skip


def replay():
    from haptorb.cli.replay_report import difference_table
    from haptorb.replay.replay import FieldBound
    from haptorb.terminal import print_table

    bounds = (FieldBound("current_measured", "A", 123456, 120, 1.234e-16, 19.87),
              FieldBound("rendered_part", "1", 2, 99999, float("nan"), 2.0))  # fmt: skip
    made = SimpleNamespace(comparison=SimpleNamespace(bounds=bounds))
    return lambda console: print_table(console, difference_table(made)), [
        "123456", "1.23e-16", "19.9", "nan", "rendered_part", "99999",
    ]  # fmt: skip


TABLES = {made.__name__: made for made in (omni_card, pmsm_card, tetrahedron_card, bench, contest, estimators, fit,
                                           train, fitness, world, guidance, replay, identification, curves, tracks,
                                           ratings)}  # fmt: skip


@pytest.fixture
def asked(monkeypatch):
    """All tables that are made."""
    found, begin = [], TextTable.__init__

    def note(self, *arguments, **named):
        begin(self, *arguments, **named)
        if sys._getframe(1).f_globals["__name__"] != TextTable.__module__:  # which makes others of them, to fit
            found.append(self)

    monkeypatch.setattr(TextTable, "__init__", note)
    return found


def flatten(text):
    return " ".join(text.split())


def words(text):
    """How often each word stands in `text`; a colon behind a head counts for nothing."""
    return Counter(word.rstrip(":") for word in text.split())


def draw(show, width, **settings):
    out = io.StringIO()
    show(Console(file=out, width=width, **settings))
    return out.getvalue()


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", TABLES)
def test_every_number_unit_and_head_is_printed_whole(asked, name, width):
    show, literals = TABLES[name]()
    printed = draw(show, width)
    long = [line for line in printed.splitlines() if cell_len(line) > width]
    assert all(len(line.split()) == 1 for line in long), long  # a path or a name of its own
    for literal in literals:
        assert literal in flatten(printed), f"{literal} is missing or torn"
    tables = list(asked)
    cells = Counter()
    for table in tables:
        for row in table.rows:
            cells += words(" ".join(row))
        for column in table.columns:
            if width >= 80 and any(row[table.columns.index(column)] for row in table.rows):
                cells |= words(column.title)
    assert tables
    assert not (missing := cells - words(printed)), missing


@pytest.mark.parametrize("name", TABLES)
def test_terminals_that_carry_ascii_only(name):
    class Ascii(io.StringIO):
        encoding = "ascii"

    show, _ = TABLES[name]()
    out = Ascii()
    show(Console(file=out, width=80))
    printed = out.getvalue()
    assert printed.isascii()
    assert all(cell_len(line) <= 80 or len(line.split()) == 1 for line in printed.splitlines())
    assert not re.search(r"\[\?|\?\]", printed)


def test_colour_is_for_terminals_that_want_it(monkeypatch):
    show, _ = fitness()
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    assert "\x1b[" not in draw(show, 80)
    assert "\x1b[1;31m" in draw(show, 80, force_terminal=True)
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b[1;31m" not in draw(show, 80, force_terminal=True)
