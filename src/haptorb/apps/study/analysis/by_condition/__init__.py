"""What every condition shows by itself: response times, scales of magnitude."""
