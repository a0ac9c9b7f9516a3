"""Reproductions of Bai 2012 and Zárate 2020, comparisons of estimators and of guidance; not part of any wheel."""
