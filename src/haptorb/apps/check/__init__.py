"""Is this computer fit for a real-time loop, and is a world inside what a loop can render? Measured, not guessed."""

from haptorb.apps.check.fitness import Fitness
from haptorb.apps.check.measure import measured
from haptorb.apps.check.rendered import boundary
from haptorb.apps.check.show import shown
from haptorb.apps.check.show_world import drawn_world, shown_world
from haptorb.apps.check.world import Setting, WorldVerdict, judged

__all__ = [
    "Fitness",
    "Setting",
    "WorldVerdict",
    "boundary",
    "drawn_world",
    "judged",
    "measured",
    "shown",
    "shown_world",
]
