"""RL-Glue and Gymnasium, each as the other: docs/gymnasium.md."""
