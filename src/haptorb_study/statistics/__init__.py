"""Statistics of a study: psychometric functions, intervals, tests, effect sizes and information."""
