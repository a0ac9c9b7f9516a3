"""Analysis of the answers of a study: tables, figures, report."""
