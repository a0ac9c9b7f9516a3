"""`haptorb frame`: registration of a tracker's frame, step by step."""
