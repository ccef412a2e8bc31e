"""Where `SharedMemoryVecEnv` was imported from before it moved to `dynaforge.sampling.vector_env`; scripts may still."""

from dynaforge.sampling.vector_env import SharedMemoryVecEnv

__all__ = ["SharedMemoryVecEnv"]
