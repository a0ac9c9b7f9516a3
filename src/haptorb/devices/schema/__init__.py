"""What every device file may say: its sections, and values with units."""
