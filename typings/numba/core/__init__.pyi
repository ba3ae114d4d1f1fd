from numba.core import config as config
from numba.core import sigutils as sigutils
