"""Mutations of `mutate_physics.py`: one factor or sign each, in all physics files and other sources of rows."""

from __future__ import annotations

from code_mutations import Mutation

__all__ = ["MUTATIONS", "PRINT_ONLY", "REASONS", "SLOW"]

SLOW = {"bai2012 figure 4", "bai2012 figure 8"}  #: parts that take minutes

#: Physics files that no reproduced row stands on, and why
REASONS = {
    "magnetics/wire.py": "the papers print no wire; catalogues of wire and counted turns are in its tests",
    "magnetics/multipole_fit.py": "the papers print the strengths of their models, but neither the points nor the "
    "weights of the fit that gave them; fits of ours are in `haptorb fit-multipole`",
}

#: Contradicted rows that compute with nothing but what is printed, so that no change of the code can turn them red
PRINT_ONLY = {
    "bai2012 ta1-pm-cone": "(A.1) as printed, of the printed angles, against the printed sizes",
    "zarate2020 fig2c-printed": "the printed line of code, as printed",
}

_E1, _E7 = "bai2012 equations 1 to 6", "bai2012 equations 7 to 9"
_T1, _T2, _T3, _A1 = "bai2012 table 1", "bai2012 table 2", "bai2012 table 3", "bai2012 table A.1"
_B, _F6, _F7, _F8 = "bai2012 appendix B", "bai2012 figure 6", "bai2012 figure 7", "bai2012 figure 8"
_F4, _TEXT = "bai2012 figure 4", "bai2012 text"
_Z1, _Z3 = "zarate2020 equations 1 and 2", "zarate2020 equations 3 to 6"
_Z2F, _Z3F, _HW, _P = "zarate2020 figure 2", "zarate2020 figure 3", "zarate2020 hardware", "zarate2020 forces"
_TOOL = "devices/electromagnet_wrench_map.py"
_CLUTCH, _DOME = "control/linkage.py", "worlds/dome.py"
_SPECIMEN = "simulation/electromagnet_specimen.py"

# No printed number stands on coils of true size: tests that compute the same in another way do.
_SPECIMEN_TESTS = "tests/simulation/electromagnet/test_electromagnet_specimen.py::"
_DRAWN = f"{_SPECIMEN_TESTS}test_what_a_drawn_one_does_is_what_loops_and_charges_in_its_core_do"
_FILE = f"{_SPECIMEN_TESTS}test_without_tolerances_it_is_the_file"
_WOUND = "tests/devices/electromagnet/test_wound_map.py::test_the_wrench_of_windings_core_and_ring"
_SENSORS = "tests/devices/electromagnet/test_wound_map.py::test_the_field_at_the_sensors_and_within_the_dome"
_ANSWER = "tests/magnetics/test_sphere_answer.py::test_the_answer_to_a_coil_is_that_to_its_charges"
_PULL = "tests/magnetics/test_sphere_answer.py::test_the_pull_on_charges_is_that_of_all_pairs"
_SERIES = "tests/magnetics/test_core_attraction.py::test_the_table_is_the_series"
_E18 = "tests/magnetics/test_core_attraction.py::test_the_pull_of_erratum_18"
_OVAL = f"{_SPECIMEN_TESTS}test_an_ellipsoid_pulls_the_magnet_otherwise_than_a_ball"
_STEEL = f"{_SPECIMEN_TESTS}test_a_steel_ball_far_away_pulls_as_a_ball_does"
_EARTH = f"{_SPECIMEN_TESTS}test_the_earths_field_turns_the_tool_and_offsets_the_sensors"
_OUTLET, _PUBLISHED = "worlds/snap_fit.py", "worlds/snap_fit.py"

MUTATIONS = (
    # beams, hook, materials
    Mutation("beams.py", "appendix_b", "plus_1", 1.1, (_B,)),
    Mutation("beams.py", "appendix_b", "plus_2", -1, (_B, _F7)),
    Mutation("beams.py", "appendix_b", "plus_3", 1.1, (_B,)),
    Mutation("beams.py", "appendix_b", "minus_1", 1.1, (_B, _F7)),
    Mutation("beams.py", "appendix_b", "minus_2", 1.1, (_B, _F7)),
    Mutation("beams.py", "compliance", "plus", 1.1, (_B, _T3)),
    Mutation("beams.py", "compliance", "minus", 1.1, (_F6,)),
    Mutation("beams.py", "balance_face", "sideways", 1.1, (_F6,)),
    Mutation("beams.py", "", "SHEAR_COEFFICIENT", 1.1, (_B,)),
    Mutation("beams.py", "force_ratio", "angle", -1, (_F6,)),
    Mutation("beams.py", "force_ratio", "out", 1.1, (_F6,)),
    Mutation("beams.py", "root_strain", "strain", 1.1, (_T3,)),
    Mutation("beams.py", "", "TABLE_3@keywords[rear].value", 1.1, (_T3,)),
    Mutation("beams.py", "Hook.section", "out", 1.1, (_B, _F6)),
    Mutation("beams.py", "Hook.shear_ratio", "return", 1.1, (_B,)),
    Mutation("beams.py", "", "MATERIALS@values[phosphor bronze].args[3]", 1.1, (_T3,)),
    # fields of bodies
    Mutation("magnetics/dipole.py", "_field", "c", 1.1, (_Z1, _Z3)),
    Mutation("magnetics/dipole.py", "_gradient", "c", 1.1, (_Z2F, _Z3F, _P)),
    Mutation("magnetics/dipole.py", "_gradient", "c", -1, (_Z1,)),
    Mutation("magnetics/dipole.py", "_gradient", "g", 1.1, (_Z1,)),
    Mutation("magnetics/dipole.py", "_field", "out[n, 0]", -1, (_Z1,)),
    Mutation("magnetics/magnets.py", "ChargedRing.__init__", "q", 1.1, (_E1, _Z1)),
    Mutation("magnetics/magnets.py", "dipole_on_charges", "s", 1.1, (_Z1,)),
    Mutation("magnetics/coil.py", "Coil.__init__", "self._density", 1.1, (_E1,)),
    Mutation("magnetics/coil.py", "Coil.filaments", "turns", 1.1, (_E1, _E7)),
    Mutation("magnetics/current_sheets.py", "_edge", "return@elts[1]", 1.1, (_T1,)),
    Mutation("magnetics/magnets.py", "CylinderMagnet.__init__", "self._sheets@args[1]", 1.1, (_E1, _E7)),
    Mutation("magnetics/magnets.py", "CylinderMagnet.moment", "return@args[0].elts[2]", 1.1, (_T1,)),
    Mutation("magnetics/elliptic_integrals.py", "integrals", "return@elts[0]", 1.1, (_T1,)),
    Mutation("magnetics/multipole.py", "_field", "q", 1.1, (_E7,)),
    Mutation("magnetics/multipole.py", "loop_poles", "radii", 1.1, (_E7, _T1)),
    Mutation("magnetics/multipole.py", "MultipoleSource.moment", "moment", 1.1, (_T1,)),
    Mutation("magnetics/source.py", "PlacedSource.field", "field", -1, (_E1, _E7)),
    Mutation("magnetics/magnets.py", "RingMagnet.filaments", "currents", 1.1, (_Z1,)),
    Mutation("magnetics/source.py", "_field", "out[n, 2]", 1.1, (_E1, _E7)),
    Mutation("magnetics/soft_sphere.py", "add_induced_field", "scale", 1.1, (_HW,)),
    Mutation("magnetics/coil.py", "_panel", "half, middle@elts[0]", 1.1, (_E1,)),
    Mutation("magnetics/current_sheets.py", "zonal", "b_z", 1.1, (_T1,)),
    Mutation("magnetics/interaction.py", "filament_wrench", "df", -1, (_E1, _E7, _Z1)),
    Mutation("magnetics/interaction.py", "_elements", "step", 1.1, (_E1, _E7, _Z1)),
    Mutation("magnetics/multipole.py", "", "MAGNET_STRENGTHS@elts[4]", 1.1, (_T1, _E7)),
    Mutation("magnetics/multipole.py", "", "MAGNET_RADIUS", 1.1, (_T1, _E7)),
    # heat and current
    Mutation("thermal.py", "TwoNode._system", "middle", 1.1, (_Z3,)),
    Mutation("thermal.py", "TwoNode.steady_rise", "body", 1.1, (_Z3,)),
    Mutation("simulation/coil_circuits.py", "_drive", "square", 1.1, (_Z3, _P)),
    Mutation("simulation/coil_circuits.py", "_drive", "end", 1.1, (_P, _HW)),
    Mutation("control/drive.py", "choose_duties", "aim", 1.1, (_Z3,)),
    Mutation("control/drive.py", "choose_duties", "largest#1", 1.1, (_Z3,)),
    Mutation("control/drive.py", "_learn_resistance", "volts", 1.1, (_Z3,)),
    # maps of the electromagnet
    Mutation("magnetics/dipole.py", "_dipole_map", "x, y, z@elts[0]", 1.1, (_Z1,)),
    Mutation("magnetics/dipole.py", "_dipole_map", "near@right", None, (_Z1,)),
    Mutation("magnetics/dipole.py", "_dipole_map", "c", -1, (_Z1,)),
    Mutation("magnetics/dipole.py", "_dipole_map", "s", 0, (_P,)),
    Mutation("magnetics/dipole.py", "_dipole_map", "out[3, j]", 0, (_P,)),
    Mutation("magnetics/core_attraction.py", "pull", "turn", 1.1, (_SERIES,)),
    Mutation("magnetics/core_attraction.py", "PassivePull.__post_init__", "scale", 1.1, (_SERIES, _E18)),
    # the electromagnet of coils and core at their true size: the controller's, then the simulation's
    Mutation(_TOOL, "fill_wound", "v2", 1.1, (_WOUND,)),
    Mutation(_TOOL, "fill_wound", "g2", 1.1, (_WOUND,)),
    Mutation(_TOOL, "fill_wound", "straight", 1.1, (_WOUND,)),
    Mutation(_TOOL, "fill_wound", "ty", -1, (_WOUND,)),
    Mutation("magnetics/coil.py", "CentredCoil.__init__", "own", 1.1, (_WOUND, _SENSORS)),
    Mutation("magnetics/coil.py", "CentredCoil.__init__", "responses", 1.1, (_WOUND, _SENSORS)),
    Mutation("magnetics/coil.py", "coil_and_core", "return", 1.1, (_SENSORS,)),
    Mutation("magnetics/soft_sphere.py", "response_to_source", "c", 1.1, (_ANSWER, _DRAWN)),
    Mutation("magnetics/soft_sphere.py", "weigh_charges", "both", 1.1, (_PULL, _DRAWN)),
    Mutation(_SPECIMEN, "_add_loops", "q", 1.1, (_DRAWN,)),
    Mutation(_SPECIMEN, "_add_loops", "out[4, j]", -1, (_DRAWN,)),
    Mutation(_SPECIMEN, "fill_truth", "passive[i]", 1.1, (_DRAWN,)),
    Mutation(_SPECIMEN, "fill_truth", "out[i, j]", 1.1, (_STEEL,)),
    Mutation(_SPECIMEN, "fill_truth", "passive[3 + i]", -1, (_EARTH,)),
    Mutation(_SPECIMEN, "ElectromagnetSpecimen.compute_stretch", "share", 1.1, (_OVAL,)),
    Mutation("magnetics/demagnetising.py", "demagnetising_factors", "return", 1.1, (_OVAL,)),
    Mutation(_SPECIMEN, "_scale_to_moments", "found#1", 1.1, (_FILE,)),
    Mutation("worlds/dome.py", "_push", "radial", 1.1, (_Z2F, _Z3F)),
    Mutation("worlds/dome.py", "_push", "radial", -1, (_Z2F, _Z3F)),
    Mutation("worlds/dome.py", "_push", "fallen", 1.1, (_Z3F,)),
    Mutation("worlds/dome.py", "_push", "alpha", 1.1, (_Z2F, _Z3F)),
    Mutation("worlds/dome.py", "_push", "d", 0.9, (_Z3F,)),
    # orientation, currents and modes of the motor
    Mutation("rotations.py", "rotation_from_euler", "ca, sa, cb, sb, cc, sc@elts[1]", -1, (_E1,)),
    Mutation("devices/motor_layout.py", "PartRing.directions", "out[:, 0]", -1, (_T2, _A1)),
    Mutation("devices/motor_file.py", "RingSection.build", "return@args[0]", 1.25, (_T2, _A1)),
    Mutation("devices/motor_wrench_map.py", "_pole_torque", "q#1", -1, (_E7,)),
    Mutation("devices/motor_wrench_map.py", "_pole_torque", "fz", 1.1, (_E7,)),
    Mutation("devices/tables.py", "torque_characteristic", "out[n, 0, j]", -1, (_E1, _E7, _TEXT)),
    Mutation("devices/tables.py", "torque_characteristic", "out[n, 0, j]", 0, (_TEXT, _E1)),
    Mutation("devices/tables.py", "sensor_field_gradient", "field[n, j, 0]", 1.1, (_TEXT,)),
    Mutation("control/minimum_power.py", "solve_bounded_power", "unit", 1.1, (_E1,)),
    Mutation("control/linkage.py", "advance_clutch", "position[0]", 1.1, (_E1,)),
    Mutation("control/linkage.py", "advance_clutch", "position[1]", 1.1, (_E1,)),
    Mutation("control/linkage.py", "advance_clutch", "position[2]", 0, (_E1,)),
    Mutation("control/linkage.py", "advance_clutch", "attitude[0]", 1.1, (_E1,)),
    Mutation("control/linkage.py", "advance_clutch", "attitude[1]", 1.1, (_E1,)),
    Mutation("control/linkage.py", "advance_clutch", "attitude[2]", 1.1, (_E1,)),
    Mutation("control/linkage.py", "fill_rotor_wrench", "Q_psi", 1.1, (_E1,)),
    Mutation("control/linkage.py", "fill_rotor_wrench", "Q_lam", -1, (_E1,)),
    Mutation("control/linkage.py", "fill_rotor_wrench", "Q_phi", 1.1, (_E1,)),
    # the network that follows K of one coil
    Mutation("../../papers/haptorb_papers/estimators/single_coil.py", "_take_readings", "per_reading", 1.1, (_F4,)),
    # the outlet
    Mutation("worlds/snap_fit.py", "_outlet", "bent", 1.1, (_T3, _F7)),
    Mutation("worlds/snap_fit.py", "_outlet", "fy", 1.1, (_F7,)),
    Mutation("worlds/snap_fit.py", "sliding_push", "drag", 1.1, (_F7,)),
    Mutation("worlds/snap_fit.py", "PublishedOutlet.wrench", "stiffness", 1.1, (_F7, _T3)),
    Mutation("worlds/snap_fit.py", "PublishedOutlet.wrench", "tan", -1, (_F7,)),
    Mutation("worlds/snap_fit.py", "PublishedOutlet.wrench", "out[5]", 1.1, (_F7,)),
    Mutation("worlds/snap_fit.py", "PublishedOutlet.wrench", "out[5]", -1, (_F7,)),
    Mutation("worlds/snap_fit.py", "PublishedOutlet.wrench", "half", 1.1, (_F8,)),
    Mutation("worlds/snap_fit.py", "PublishedOutlet.wrench", "f_2", 1.1, (_F8,)),
    Mutation("worlds/snap_fit.py", "PublishedOutlet.wrench", "tan", 1.5, (_F8,)),
)
