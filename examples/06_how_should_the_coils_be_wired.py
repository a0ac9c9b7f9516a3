"""
How should the coils be wired?
==============================

Adjacent magnets of the spherical motor alternate, but in which way: along each ring only, or across the two rings as
well? And which way round are the two coils of a pair connected? Two of the four combinations do nothing at all; which
of the other two is better?
"""

import matplotlib.pyplot as plt
import numpy as np

import haptorb

tilt = np.radians(np.linspace(-22.5, 22.5, 9))
spin = np.radians(np.arange(0, 30, 3))  # the field repeats every 60°, and changes sign every 30°
R_SR = haptorb.rotation_from_euler(*np.meshgrid(tilt, tilt, spin, indexing="ij")).reshape(-1, 3, 3)

weakest = {}
for name, wired in (("pmsm", "series-opposed"), ("pmsm-in-phase", "series-aiding")):
    K = haptorb.torque_characteristic(name, R_SR, grouped=True)
    values = np.linalg.svd(K, compute_uv=False)
    weakest[f"{name}, {wired}"] = values[:, 2].reshape(9, 9, -1).min(axis=2)

figure, places = plt.subplots(1, 2, figsize=(9, 4), sharey=True, layout="constrained")
for place, (title, least) in zip(places, weakest.items(), strict=True):
    picture = place.pcolormesh(np.degrees(tilt), np.degrees(tilt), least.T, vmin=0.15, vmax=0.45, shading="gouraud")
    place.set(title=title, xlabel="ψ [°]", aspect="equal")
places[0].set_ylabel("λ [°]")
figure.colorbar(picture, ax=places, label="torque per ampere about the weakest axis [N·m/A]")

# %%
# The checkerboard is half as strong again where the motor is weakest.
least = [float(values.min()) for values in weakest.values()]
print(f"{least[0]:.3f} and {least[1]:.3f} N·m/A: {least[0] / least[1]:.2f} times")
assert 1.5 < least[0] / least[1] < 1.7
