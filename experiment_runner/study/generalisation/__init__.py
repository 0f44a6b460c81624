"""Scores of agents on unseen levels of Infinite Mario: docs/generalisation.md."""
