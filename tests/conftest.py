"""What all tests share: compiled forms and kernels are kept where a run keeps them."""

from restoration.environment import use_jit_cache, use_numba_cache

use_numba_cache()
use_jit_cache()
