"""How well agents play levels of Infinite Mario that they have not seen: docs/generalisation.md."""
