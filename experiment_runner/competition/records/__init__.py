"""What was played in a competition: written down, and played again to verify it."""
