"""Statistics over sequences: intervals, tests, comparison and skill."""
