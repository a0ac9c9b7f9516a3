"""Is this computer fit for a real-time loop, and is a world inside what a loop can render? Measured, not guessed."""

from haptorb.apps.check.fitness import Fitness
from haptorb.apps.check.measure import measure_fitness
from haptorb.apps.check.show import print_fitness
from haptorb.apps.check.show_world import draw_world, print_world
from haptorb.apps.check.stability_trial import boundary
from haptorb.apps.check.world import Setting, WorldVerdict, judge_world

__all__ = [
    "Fitness",
    "Setting",
    "WorldVerdict",
    "boundary",
    "draw_world",
    "judge_world",
    "measure_fitness",
    "print_fitness",
    "print_world",
]
