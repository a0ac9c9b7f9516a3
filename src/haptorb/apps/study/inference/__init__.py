"""What follows from the answers of some people for all people: intervals, tests, psychometric functions."""
