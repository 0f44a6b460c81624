"""The agents of Mohan, Reinforcement Learning in Infinite Mario (2010)."""
