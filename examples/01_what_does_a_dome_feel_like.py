"""
What does a dome feel like?
===========================

The force map of Zárate et al. 2020 with half width 18° and cut-off 54°: the force that the world commands while a tool
slides down the dome, and the force that coils and core deliver.
"""

import matplotlib.pyplot as plt
import numpy as np

import haptorb
from haptorb.worlds import Dome

omni = haptorb.load("omni")
dome = Dome(half_width_deg=18, cut_off_deg=54, moment=2.4).for_device(omni)

# %%
# A radial tool in contact, from the summit down one meridian.
angle = np.radians(np.linspace(0.0, 60.0, 241))
outward = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)
places = omni.contact_distance * outward
asked = np.array([dome.wrench(haptorb.State.at(p))[:3] for p in places])
radial = (asked * outward).sum(axis=1)
given, saturated = haptorb.force_map(omni, dome, places)
published, _ = haptorb.force_map(omni, dome, places, model="published")

figure, axes = plt.subplots(figsize=(7, 4))
axes.axhline(0.0, color="0.8")
axes.plot(np.degrees(angle), 1e3 * radial, "--", label="commanded")
axes.plot(np.degrees(angle), 1e3 * given, label="delivered, controller with the exact model")
axes.plot(np.degrees(angle), 1e3 * published, label="delivered, controller with the published model")
axes.set(xlabel="angle from the summit [deg]", ylabel="radial force, outward [mN]", title="A dome of 18°, cut at 54°")
axes.legend()
figure.tight_layout()

# %%
# The commanded force changes sign at θ₁ = 18° and is exactly zero from θ₂ = 54° on. A controller that inverts the exact
# model delivers it. One that inverts the paper's point dipoles does not know the core's pull, which
# remains.
zero = np.degrees(angle[np.argmax(radial < 0)])
assert abs(zero - 18.0) <= 0.25
assert not asked[angle >= np.radians(54.0)].any()
assert np.abs(given - radial)[~saturated].max() < 1e-6
assert -0.055 < published[-1] < -0.050
