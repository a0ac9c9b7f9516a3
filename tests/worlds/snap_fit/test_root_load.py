"""Strain and stress at a hook's root: against the shape of the bent beam, and flagged beyond yield."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.beams import MATERIALS, TABLE_3, compliance, compute_bent_shape, root_strain
from haptorb.web.session import world_remarks
from haptorb.worlds import Outlet, SnapFit


@pytest.mark.parametrize("place", [TABLE_3.ramp_end, TABLE_3.peak])
def test_strain_is_half_the_thickness_times_the_curvature_at_the_root(place: float) -> None:
    shape = compute_bent_shape(TABLE_3, place, 0.75e-3, points=4001)
    step = shape[1, 0]
    curvature = np.diff(shape[:40, 1], 2) / step**2
    at_root = np.polyval(np.polyfit(shape[1:39, 0], curvature, 1), 0.0)
    strain = root_strain(TABLE_3, place, 0.75e-3, compliance(TABLE_3, place).plus)
    assert strain == pytest.approx(0.5 * TABLE_3.thickness * at_root, rel=1e-3)


def test_the_published_outlet_would_stay_bent_with_either_beam() -> None:
    right, paper = Outlet().root_load, Outlet(beam="paper").root_load
    assert (right.stress, paper.stress) == pytest.approx((0.89e9, 4.18e9), rel=0.005)
    assert right.material == "phosphor bronze"
    assert right.beyond_yield
    assert right.margin == pytest.approx(530 / 892, abs=1e-3)
    assert paper.sentence.startswith("root strain 3.7 %, stress 4.18 GPa: BEYOND YIELD of phosphor bronze (530 MPa)")


def test_a_hook_is_bent_most_at_the_end_of_its_top_that_is_nearer_to_the_root() -> None:
    world = SnapFit()
    at_peak = root_strain(world.hook, world.hook.peak, world.height, compliance(world.hook, world.hook.peak).plus)
    assert world.root_load.strain > 1.1 * float(at_peak)
    assert world.root_load.margin == pytest.approx(44e6 / world.root_load.stress)
    assert not world.root_load.beyond_yield
    assert SnapFit(clearance=0.75e-3).root_load.strain == pytest.approx(0.5 * world.root_load.strain, rel=1e-2)
    assert SnapFit(clearance=2e-3).root_load.strain == 0.0  # nothing touches


def test_a_material_that_is_not_in_the_table_has_no_margin() -> None:
    load = SnapFit(material="oak").root_load
    assert (load.margin, load.beyond_yield) == (None, False)
    assert "the yield strength of 'oak' is not known" in load.sentence


@pytest.mark.parametrize("name", sorted(MATERIALS))
def test_every_material_yields_between_a_thousandth_and_a_twentieth_of_its_modulus(name: str) -> None:
    material = MATERIALS[name]
    assert 1e-3 < material.yield_strength / material.youngs_modulus < 0.05


@pytest.mark.parametrize("name", sorted(MATERIALS))
def test_every_material_has_its_strains_in_order_a_condition_and_a_source(name: str) -> None:
    material = MATERIALS[name]
    assert 0 < material.repeated_strain <= material.permissible_strain < material.breaking_strain
    if material.metal:  # elastic to the end
        assert material.permissible_strain == pytest.approx(material.yield_strength / material.youngs_modulus, rel=0.02)
    assert material.condition
    assert material.source


def test_polyamide_is_softer_and_tougher_with_its_water() -> None:
    dry, wet = MATERIALS["PA66"], MATERIALS["PA66 conditioned"]
    assert wet.youngs_modulus < 0.5 * dry.youngs_modulus
    assert wet.permissible_strain > dry.permissible_strain


def test_a_hook_that_breaks_before_it_snaps_is_told() -> None:
    stub = SnapFit(base_length=5e-3, peak=8.5e-3, thickness=2.5e-3, height=2e-3, insertion_deg=20.0)
    assert stub.root_load.strain > MATERIALS["ABS"].breaking_strain
    assert stub.root_load.breaks
    assert "BREAKS BEFORE IT SNAPS: ABS breaks at a strain of 12 %" in stub.remarks[0]
    assert stub.root_load.numbers()["breaks"] is True
    good = SnapFit().root_load
    assert not good.breaks
    assert good.sentence.endswith("permissible strain 1.68 % once, 1.01 % if opened often: EXCEEDED if opened often")


def test_worlds_that_are_no_hooks_say_nothing_and_hooks_say_what_is_set() -> None:
    assert world_remarks("dome", {}) == []
    assert world_remarks("a world that nobody made", {}) == []
    (told,) = world_remarks("outlet", {"opening": 6.0e-3})
    assert told == Outlet(opening=6.0e-3).root_load.sentence
    assert "below the yield strength" in told
    assert (Outlet() + SnapFit()).remarks == (Outlet().root_load.sentence, SnapFit().root_load.sentence)
    assert Outlet().root_load.sentence in Outlet()._repr_html_()
