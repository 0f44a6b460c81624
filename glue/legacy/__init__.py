"""The gateway for original RL-Glue 3.x programs, in their own binary protocol."""
