"""Physical effects: each a function from Problem to Problem, all through one door."""

from .door import Effect, catalogue, effect

__all__ = ["Effect", "catalogue", "effect"]
