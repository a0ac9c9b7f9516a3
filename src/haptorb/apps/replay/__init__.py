"""`haptorb replay`: what a replay found, in words, numbers and one picture."""
