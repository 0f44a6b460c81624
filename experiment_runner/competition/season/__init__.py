"""A season: a competition that stays open for weeks, with as many attempts as its rules allow."""
