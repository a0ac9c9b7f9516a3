"""From what was measured to the state of the tool: Sample in, Estimate out."""
