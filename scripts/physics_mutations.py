"""What `mutate_physics.py` changes: one factor or sign each, in every physics file and in what else rows stand on."""

from __future__ import annotations

from code_mutations import Mutation

__all__ = ["MUTATIONS", "PRINT_ONLY", "REASONS", "SLOW"]

SLOW = {"bai2012 figure 4", "bai2012 figure 8"}  #: parts that take minutes

#: Physics files that no reproduced row stands on, and why
REASONS = {
    "physics/fast_fields/sphere_answer.py": "serves arrays of coils, which no paper here describes; checked against "
    "`soft_sphere`",
    "physics/fast_fields/winding_table.py": "the same; checked against `Coil`",
    "physics/materials.py": "constants of handbooks; of them the papers print E and ν, which are transcribed (E7), and "
    "no strength; a change of a yield strength turns the contradicted row of E29 red",
    "physics/multipole_fit.py": "the papers print the strengths of their models, but neither the points nor the "
    "weights of the fit that gave them; fits of ours are in `haptorb fit-multipole`",
    "physics/sources/bessel.py": "serves the self-inductance of coils; the papers print none",
    "physics/sources/soft_sphere.py": "the papers print no pull of the core but 'small', which is contradicted (E18): "
    "that row turns red",
    "physics/thermal_network.py": "of heat the papers print three endurances, to which the network was fitted: they "
    "are assumed",
    "physics/sources/source.py": "the interface of sources; it computes nothing",
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
_SOURCES = "physics/sources/"
_TOOL = "devices/electromagnet/ring_tool.py"
_CLUTCH, _DOME = "control/clutch/mode_kernels.py", "worlds/maps/dome.py"
_OUTLET, _PUBLISHED = "worlds/snap_fit/outlet.py", "worlds/snap_fit/published_outlet.py"

MUTATIONS = (
    # beams, hook, materials
    Mutation("physics/beams.py", "appendix_b", "plus_1", 1.1, (_B,)),
    Mutation("physics/beams.py", "appendix_b", "plus_2", -1, (_B, _F7)),
    Mutation("physics/beams.py", "appendix_b", "plus_3", 1.1, (_B,)),
    Mutation("physics/beams.py", "appendix_b", "minus_1", 1.1, (_B, _F7)),
    Mutation("physics/beams.py", "appendix_b", "minus_2", 1.1, (_B, _F7)),
    Mutation("physics/beams.py", "compliance", "plus", 1.1, (_B, _T3)),
    Mutation("physics/beams.py", "compliance", "plus#1", 1.1, (_F6, _F7)),
    Mutation("physics/beams.py", "", "SHEAR_COEFFICIENT", 1.1, (_B,)),
    Mutation("physics/beams.py", "force_ratio", "angle", -1, (_F6,)),
    Mutation("physics/beams.py", "force_ratio", "out", 1.1, (_F6,)),
    Mutation("physics/beams.py", "root_strain", "strain", 1.1, (_T3,)),
    Mutation("physics/hook.py", "", "TABLE_3@keywords[6].value", 1.1, (_T3,)),
    Mutation("physics/hook.py", "Hook.section", "out", 1.1, (_B, _F6)),
    Mutation("physics/hook.py", "Hook.shear_ratio", "return", 1.1, (_B,)),
    Mutation("physics/materials.py", "", "MATERIALS@values[6].args[3]", 1.1, (_T3,)),
    # fields of bodies
    Mutation(_SOURCES + "dipole.py", "_field", "c", 1.1, (_Z1, _Z3)),
    Mutation(_SOURCES + "dipole.py", "_gradient", "c", 1.1, (_Z2F, _Z3F, _P)),
    Mutation(_SOURCES + "dipole.py", "_gradient", "c", -1, (_Z1,)),
    Mutation(_SOURCES + "dipole.py", "_field", "out[n, 0]", -1, (_Z1,)),
    Mutation(_SOURCES + "charged_ring.py", "ChargedRing.__init__", "q", 1.1, (_E1, _Z1)),
    Mutation(_SOURCES + "charged_ring.py", "dipole_on_charges", "s", 1.1, (_Z1,)),
    Mutation(_SOURCES + "coil.py", "Coil.__init__", "self._density", 1.1, (_E1,)),
    Mutation(_SOURCES + "coil.py", "Coil.filaments", "turns", 1.1, (_E1, _E7)),
    Mutation(_SOURCES + "current_sheet.py", "_edge", "return@elts[1]", 1.1, (_T1,)),
    Mutation(_SOURCES + "cylinder.py", "CylinderMagnet.__init__", "self._sheets@args[1]", 1.1, (_E1, _E7)),
    Mutation(_SOURCES + "cylinder.py", "CylinderMagnet.moment", "return@args[0].elts[2]", 1.1, (_T1,)),
    Mutation(_SOURCES + "elliptic.py", "integrals", "return@elts[0]", 1.1, (_T1,)),
    Mutation(_SOURCES + "multipole.py", "_field", "q", 1.1, (_E7,)),
    Mutation(_SOURCES + "multipole.py", "loop_poles", "radii", 1.1, (_E7, _T1)),
    Mutation(_SOURCES + "multipole.py", "MultipoleSource.moment", "moment", 1.1, (_T1,)),
    Mutation(_SOURCES + "placement.py", "PlacedSource.field", "field", -1, (_E1, _E7)),
    Mutation(_SOURCES + "ring.py", "RingMagnet.filaments", "currents", 1.1, (_Z1,)),
    Mutation(_SOURCES + "round_body.py", "_field", "out[n, 2]", 1.1, (_E1, _E7)),
    Mutation(_SOURCES + "soft_sphere.py", "add_induced_field", "scale", 1.1, (_HW,)),
    Mutation(_SOURCES + "winding_field.py", "_panel", "half, middle@elts[0]", 1.1, (_E1,)),
    Mutation(_SOURCES + "zonal.py", "zonal", "b_z", 1.1, (_T1,)),
    Mutation("physics/interaction.py", "filament_wrench", "df", -1, (_E1, _E7, _Z1)),
    Mutation("physics/interaction.py", "_elements", "step", 1.1, (_E1, _E7, _Z1)),
    Mutation("physics/published_multipoles.py", "", "MAGNET_STRENGTHS@elts[4]", 1.1, (_T1, _E7)),
    Mutation("physics/published_multipoles.py", "", "MAGNET_RADIUS", 1.1, (_T1, _E7)),
    # heat and current
    Mutation("physics/thermal.py", "TwoNode._system", "middle", 1.1, (_Z3,)),
    Mutation("physics/thermal.py", "TwoNode.steady_rise", "body", 1.1, (_Z3,)),
    Mutation("simulation/parts/coils.py", "_drive", "square", 1.1, (_Z3, _P)),
    Mutation("simulation/parts/coils.py", "_drive", "end", 1.1, (_P, _HW)),
    Mutation("control/protection/drive.py", "choose_duties", "aim", 1.1, (_Z3,)),
    Mutation("control/protection/drive.py", "choose_duties", "largest#1", 1.1, (_Z3,)),
    Mutation("control/protection/drive.py", "_learn_resistance", "volts", 1.1, (_Z3,)),
    # maps of the electromagnet
    Mutation(_TOOL, "_dipole_map", "x, y, z@elts[0]", 1.1, (_Z1,)),
    Mutation(_TOOL, "_dipole_map", "near@right", None, (_Z1,)),
    Mutation(_TOOL, "_dipole_map", "c", -1, (_Z1,)),
    Mutation(_TOOL, "_dipole_map", "s", 0, (_P,)),
    Mutation(_TOOL, "_dipole_map", "out[3, j]", 0, (_P,)),
    Mutation(_DOME, "_push", "radial", 1.1, (_Z2F, _Z3F)),
    Mutation(_DOME, "_push", "radial", -1, (_Z2F, _Z3F)),
    Mutation(_DOME, "_push", "fallen", 1.1, (_Z3F,)),
    Mutation(_DOME, "_push", "alpha", 1.1, (_Z2F, _Z3F)),
    Mutation(_DOME, "_push", "d", 0.9, (_Z3F,)),
    # orientation, currents and modes of the motor
    Mutation("numerics/rotations.py", "rotation_from_euler", "ca, sa, cb, sb, cc, sc@elts[1]", -1, (_E1,)),
    Mutation("devices/motor/layouts.py", "PartRing.directions", "out[:, 0]", -1, (_T2, _A1)),
    Mutation("devices/motor/magnetics_schema.py", "RingSection.build", "return@args[0]", 1.25, (_T2, _A1)),
    Mutation("devices/motor/models.py", "_pole_torque", "q#1", -1, (_E7,)),
    Mutation("devices/motor/models.py", "_pole_torque", "fz", 1.1, (_E7,)),
    Mutation("devices/tables/table_kernels.py", "torque_characteristic", "out[n, 0, j]", -1, (_E1, _E7, _TEXT)),
    Mutation("devices/tables/table_kernels.py", "torque_characteristic", "out[n, 0, j]", 0, (_TEXT, _E1)),
    Mutation("devices/tables/table_kernels.py", "sensor_field_gradient", "field[n, j, 0]", 1.1, (_TEXT,)),
    Mutation("control/allocation/bounded_power.py", "solve_bounded_power", "unit", 1.1, (_E1,)),
    Mutation(_CLUTCH, "advance_clutch", "position[0]", 1.1, (_E1,)),
    Mutation(_CLUTCH, "advance_clutch", "position[1]", 1.1, (_E1,)),
    Mutation(_CLUTCH, "advance_clutch", "position[2]", 0, (_E1,)),
    Mutation(_CLUTCH, "advance_clutch", "attitude[0]", 1.1, (_E1,)),
    Mutation(_CLUTCH, "advance_clutch", "attitude[1]", 1.1, (_E1,)),
    Mutation(_CLUTCH, "advance_clutch", "attitude[2]", 1.1, (_E1,)),
    Mutation(_CLUTCH, "fill_rotor_wrench", "Q_psi", 1.1, (_E1,)),
    Mutation(_CLUTCH, "fill_rotor_wrench", "Q_lam", -1, (_E1,)),
    Mutation(_CLUTCH, "fill_rotor_wrench", "Q_phi", 1.1, (_E1,)),
    # the network that follows K of one coil
    Mutation("apps/estimators/single_coil.py", "_take_readings", "per_reading", 1.1, (_F4,)),
    # the outlet
    Mutation(_OUTLET, "_outlet", "bent", 1.1, (_T3, _F7)),
    Mutation(_OUTLET, "_outlet", "fy", 1.1, (_F7,)),
    Mutation("worlds/snap_fit/sliding.py", "sliding_push", "drag", 1.1, (_F7,)),
    Mutation(_PUBLISHED, "PublishedOutlet.wrench", "stiffness", 1.1, (_F7, _T3)),
    Mutation(_PUBLISHED, "PublishedOutlet.wrench", "tan", -1, (_F7,)),
    Mutation(_PUBLISHED, "PublishedOutlet.wrench", "out[5]", 1.1, (_F7,)),
    Mutation(_PUBLISHED, "PublishedOutlet.wrench", "out[5]", -1, (_F7,)),
    Mutation(_PUBLISHED, "PublishedOutlet.wrench", "half", 1.1, (_F8,)),
    Mutation(_PUBLISHED, "PublishedOutlet.wrench", "f_2", 1.1, (_F8,)),
    Mutation(_PUBLISHED, "PublishedOutlet.wrench", "tan", 1.5, (_F8,)),
)
