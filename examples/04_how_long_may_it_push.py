"""
How long may it push?
=====================

A coil stores heat in its copper and its body, and warms the other coils. At a steady current in one coil, or in all
three, when must the guard begin to derate?
"""

import matplotlib.pyplot as plt
import numpy as np

import haptorb

omni = haptorb.load("omni")
heat = omni.coils.heat
network = heat.network(3)
at_ambient = omni.coils.resistance_at(np.full(3, heat.ambient))
one, all_three = np.array([1.0, 0.0, 0.0]), np.ones(3)

currents = np.linspace(2.5, 20.0, 71)
times, together = (
    np.array([network.time_to(heat.derate - heat.ambient, i**2 * at_ambient * on, drive="current") for i in currents])
    for on in (one, all_three)
)
sustained, sustained_together = float(omni.sustained_current[0]), float(omni.sustained_current_together[0])

figure, axes = plt.subplots(figsize=(7, 4))
axes.semilogy(currents, times, label="one coil")
axes.semilogy(currents, together, label="all three")
for current in (sustained, sustained_together):
    axes.axvline(current, color="0.6", linestyle=":")
axes.set(xlabel="current [A]", ylabel="time to derating [s]")
axes.legend()
figure.tight_layout()

# %%
# A few seconds at full current; without a time limit below the continuous current.
print(f"{times[-1]:.1f} s at {currents[-1]:.0f} A in one coil")
print(f"{sustained:.2f} A continuous in one coil, {sustained_together:.2f} A in all three")
assert 3.0 < times[-1] < 6.0
assert np.isinf(times[currents < 0.99 * sustained]).all()
assert np.isfinite(times[currents > 1.01 * sustained]).all()
assert np.isinf(together[currents < 0.99 * sustained_together]).all()
assert np.isfinite(together[currents > 1.01 * sustained_together]).all()
