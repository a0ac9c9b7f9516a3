"""
How wrong is a point dipole?
============================

The tool's magnet is a ring of 24 mm length. How much larger is the force of a dipole on it than on a point dipole of
the same moment, and from which distance is a point dipole good enough? (The coils are no point dipole either: the model
``exact`` has both.)
"""

import matplotlib.pyplot as plt
import numpy as np

import haptorb

omni = haptorb.load("omni")
distance = np.linspace(0.045, 0.12, 76)
force = {
    model: np.array([haptorb.wrench_map(omni, haptorb.State.at((0, 0, d)), model=model).matrix[2, 2] for d in distance])
    for model in ("published", "point-coils")
}
excess = force["point-coils"] / force["published"] - 1

figure, axes = plt.subplots(figsize=(7, 4))
axes.plot(1e3 * distance, 100 * excess)
axes.axhspan(0, 7, color="0.92", label="below the just-noticeable difference")
axes.axvline(1e3 * omni.contact_distance, color="0.6", linestyle=":", label="contact")
axes.set(xlabel="distance from the centre [mm]", ylabel="excess of the ring's force [%]")
axes.legend()
figure.tight_layout()

# %%
# At contact the excess is two just-noticeable differences.
at_contact = float(np.interp(omni.contact_distance, distance, excess))
print(f"{100 * at_contact:.1f} % at contact")
assert abs(at_contact - 0.156) < 0.002
assert (np.diff(excess) < 0).all()
