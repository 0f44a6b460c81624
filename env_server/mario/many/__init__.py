"""Many games of Infinite Mario stepped in one compiled call, for Gymnasium, planners and the wire."""
