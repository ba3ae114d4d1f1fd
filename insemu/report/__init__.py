"""Figures and one self-contained HTML page, for experiments, signals, fits and gaps.

The door is the modules: a command imports that of its own page, and does not load what the pages of the others need.
"""

from pkgutil import iter_modules

__all__ = [module.name for module in iter_modules(__path__)]
