"""The types of the names at the top, which ``__init__.py`` finds when they are asked for."""

import insemu.noise as _noise
from insemu.api import characterise as characterise
from insemu.api import emulate as emulate
from insemu.api import examine as examine
from insemu.api import find_gap as find_gap
from insemu.api import fit as fit
from insemu.api import load as load
from insemu.api import plot as plot
from insemu.api import read as read
from insemu.api import referee as referee
from insemu.api import require as require
from insemu.api import run as run
from insemu.api import select as select
from insemu.api import solve as solve
from insemu.emulate import corrupt as corrupt
from insemu.emulate import gnss_fixes as gnss_fixes
from insemu.emulate import ideal_imu as ideal_imu
from insemu.errors import InputError as InputError
from insemu.evaluate import Experiment as Experiment
from insemu.evaluate import Results as Results
from insemu.filters import NavigationFilter as NavigationFilter
from insemu.filters import register_filter as register_filter
from insemu.noise import NoiseModel as NoiseModel
from insemu.noise import Process as Process
from insemu.noise.processes import held as _held
from insemu.noise.processes import second_order as _second_order
from insemu.records import GnssRecord as GnssRecord
from insemu.records import ImuRecord as ImuRecord
from insemu.records import Recording as Recording
from insemu.records import Series as Series
from insemu.records import Trajectory as Trajectory
from insemu.scenario import Scenario as Scenario

register_process = _noise.register

__version__: str
__all__: list[str]

# parameters are numbers in SI units, or text with a unit
class WN(_noise.WN):
    def __init__(
        self, N: float | str | None = ..., *, shared: str = ..., follows: _noise.Follows | None = ...
    ) -> None: ...

class RW(_noise.RW):
    def __init__(
        self,
        K: float | str | None = ...,
        sigma0: float | str = ...,
        *,
        shared: str = ...,
        follows: _noise.Follows | None = ...,
    ) -> None: ...

class GM(_noise.GM):
    def __init__(
        self,
        sigma: float | str | None = ...,
        beta: float | str | None = ...,
        *,
        Tc: float | str = ...,
        shared: str = ...,
        follows: _noise.Follows | None = ...,
    ) -> None: ...

class GM2(_second_order.GM2):
    def __init__(
        self,
        sigma: float | str | None = ...,
        beta: float | str | None = ...,
        *,
        Tc: float | str = ...,
        shared: str = ...,
        follows: _noise.Follows | None = ...,
    ) -> None: ...

class AR1(_noise.AR1):
    def __init__(
        self,
        phi: float | str | None = ...,
        sigma2: float | str | None = ...,
        rate_hz: float | str | None = ...,
        *,
        shared: str = ...,
        follows: _noise.Follows | None = ...,
    ) -> None: ...

class AR(_noise.AR):
    def __init__(
        self,
        ar: tuple[float | None, ...] = ...,
        ma: tuple[float | None, ...] = ...,
        sigma2: float | str | None = ...,
        rate_hz: float | str | None = ...,
        *,
        shared: str = ...,
        follows: _noise.Follows | None = ...,
    ) -> None: ...

class MA(_noise.MA):
    def __init__(
        self,
        ar: tuple[float | None, ...] = ...,
        ma: tuple[float | None, ...] = ...,
        sigma2: float | str | None = ...,
        rate_hz: float | str | None = ...,
        *,
        shared: str = ...,
        follows: _noise.Follows | None = ...,
    ) -> None: ...

class ARMA(_noise.ARMA):
    def __init__(
        self,
        ar: tuple[float | None, ...] = ...,
        ma: tuple[float | None, ...] = ...,
        sigma2: float | str | None = ...,
        rate_hz: float | str | None = ...,
        *,
        shared: str = ...,
        follows: _noise.Follows | None = ...,
    ) -> None: ...

class QN(_noise.QN):
    def __init__(
        self, Q: float | str | None = ..., *, shared: str = ..., follows: _noise.Follows | None = ...
    ) -> None: ...

class DR(_noise.DR):
    def __init__(
        self, R: float | str | None = ..., *, shared: str = ..., follows: _noise.Follows | None = ...
    ) -> None: ...

class BI(_noise.BI):
    def __init__(
        self,
        B: float | str | None = ...,
        tau_from: float | str = ...,
        tau_to: float | str = ...,
        *,
        shared: str = ...,
        follows: _noise.Follows | None = ...,
    ) -> None: ...

class PWC(_held.PWC):
    def __init__(
        self,
        sigma: float | str | None = ...,
        T: float | str | None = ...,
        *,
        shared: str = ...,
        follows: _noise.Follows | None = ...,
    ) -> None: ...

class SIN(_noise.SIN):
    def __init__(
        self,
        alpha: float | str | None = ...,
        f: float | str | None = ...,
        *,
        shared: str = ...,
        follows: _noise.Follows | None = ...,
    ) -> None: ...

class RC(_noise.RC):
    def __init__(
        self, sigma: float | str | None = ..., *, shared: str = ..., follows: _noise.Follows | None = ...
    ) -> None: ...
