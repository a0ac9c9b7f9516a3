"""Is this computer fit for a real-time loop? Measured with the loop itself, not with a stand-in."""

from haptorb.apps.check.fitness import Fitness
from haptorb.apps.check.measure import measured
from haptorb.apps.check.show import shown

__all__ = ["Fitness", "measured", "shown"]
