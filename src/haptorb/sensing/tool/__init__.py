"""The tool's place and axis from field readings: the Hall tracker."""
