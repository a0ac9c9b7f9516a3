"""What the answers say: statistics, figures, report."""
