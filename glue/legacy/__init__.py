"""Original RL-Glue 3.x programs, spoken to in their own binary format."""
