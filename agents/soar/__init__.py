"""Agents made of Soar productions, run by the Soar kernel."""
