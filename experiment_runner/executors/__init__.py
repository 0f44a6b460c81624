"""Carrying out a plan: in this process, in worker processes of this machine, or on a Ray cluster."""
