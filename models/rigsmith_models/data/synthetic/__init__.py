"""Characters made by rule: body, skeleton, mesh and skin weights, all from one seed.

Reading order: ``shapes`` (the two primitives), ``sketch`` (a character under construction), ``parts`` and ``clothing``
(what is put together), ``families`` (how), ``surface`` (shapes -> mesh), ``skin`` (shapes -> weights), ``generate`` (all).
"""

from .generate import GENERATOR_VERSION, Character, generate

__all__ = ["GENERATOR_VERSION", "Character", "generate"]
