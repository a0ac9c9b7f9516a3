"""
What does the core do by itself?
================================

All currents are off. The iron sphere is still magnetised by the tool and pulls it. How hard, and how does a tilt of the
tool change it?
"""

import matplotlib.pyplot as plt
import numpy as np

import haptorb

omni = haptorb.load("omni")
distance = np.linspace(0.05, 0.08, 61)
pull = np.array([-haptorb.wrench_map(omni, haptorb.State.at((0, 0, d)), model="exact").passive[2] for d in distance])

tilt = np.radians(np.linspace(0.0, 60.0, 61))
axis = np.stack([np.sin(tilt), np.zeros_like(tilt), np.cos(tilt)], axis=-1)
contact = (0.0, 0.0, omni.contact_distance)
tilted = np.array([haptorb.wrench_map(omni, haptorb.State.at(contact, axis=a), model="exact").passive for a in axis])

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6))
left.semilogy(1e3 * distance, 1e3 * pull)
left.set(xlabel="distance from the centre [mm]", ylabel="pull [mN]", title="radial tool")
right.plot(np.degrees(tilt), -1e3 * tilted[:, 2], label="pull [mN]")
right.plot(np.degrees(tilt), 1e3 * tilted[:, 4], label="torque [mN·m]")
right.set(xlabel="tilt of the tool [deg]", title="at contact")
right.legend()
figure.tight_layout()

# %%
# 52.9 mN at contact: a quarter of the continuous radial force there, 0.22 N with one coil warm (`haptorb inspect
# omni`).
print(f"{1e3 * pull[0]:.1f} mN at {1e3 * distance[0]:.0f} mm")
assert abs(pull[0] - 0.0529) < 0.0005
assert (np.diff(pull) < 0).all()
