"""The former home of `SharedMemoryVecEnv`, now in `dynaforge.sampling.vector_env`, for scripts that import it here."""

from dynaforge.sampling.vector_env import SharedMemoryVecEnv

__all__ = ["SharedMemoryVecEnv"]
