"""
How long may it push?
=====================

A coil stores heat in its copper and its body. At a steady current, when must the guard begin to derate?
"""

import matplotlib.pyplot as plt
import numpy as np

import haptorb
from haptorb.physics.thermal import TwoNode

omni = haptorb.load("omni")
heat = omni.coils.heat
winding_and_body = TwoNode(heat.winding_capacity, heat.body_capacity, heat.winding_to_body, heat.body_to_air)
at_ambient = float(omni.coils.resistance_at(np.full(3, heat.ambient))[0])

currents = np.linspace(4.0, 20.0, 65)
times = np.array(
    [winding_and_body.time_to(heat.derate - heat.ambient, i**2 * at_ambient, drive="current") for i in currents]
)
sustained = float(omni.sustained_current[0])

figure, axes = plt.subplots(figsize=(7, 4))
axes.semilogy(currents, times)
axes.axvline(sustained, color="0.6", linestyle=":", label="continuous")
axes.set(xlabel="current [A]", ylabel="time to derating [s]")
axes.legend()
figure.tight_layout()

# %%
# A few seconds at full current; without a time limit below the continuous current.
print(f"{times[-1]:.1f} s at {currents[-1]:.0f} A; {sustained:.2f} A continuous")
assert 3.0 < times[-1] < 6.0
assert np.isinf(times[currents < 0.99 * sustained]).all()
assert np.isfinite(times[currents > 1.01 * sustained]).all()
