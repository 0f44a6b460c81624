"""The other end of a hub: what connects an agent, an environment or an experiment to it."""
