"""The processes of inertial sensor errors, each said once, in one module.

Every process is a frozen set of parameters. A parameter left out is unknown: ``GM()`` is a structure to be fitted. Closed forms take the
sampling interval ``dt``, because what a filter or an estimator sees is the sampled sequence: averages of m samples, frequencies up to
1 / (2 dt), lags in samples.

What each is stands in a table of docs/fitting.md.

A module in this folder is read when the package is: the processes that it defines are known by name from then on, and nothing else has to
name them.
"""

from importlib import import_module
from importlib.metadata import entry_points
from pkgutil import iter_modules

from insemu.noise.process import PROCESSES, Process, register

for _found in iter_modules(__path__):
    _module = import_module(f"{__name__}.{_found.name}")
    for _name, _value in vars(_module).items():
        if isinstance(_value, type) and issubclass(_value, Process) and _value.__module__ == _module.__name__:
            PROCESSES[_name] = _value
for _entry in entry_points(group="insemu.processes"):  # of other packages
    register(_entry.load())
