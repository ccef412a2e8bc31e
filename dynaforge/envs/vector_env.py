"""Where `SharedMemoryVecEnv` was before it moved to `dynaforge.sampling.vector_env`; scripts may import it here."""

from dynaforge.sampling.vector_env import SharedMemoryVecEnv

__all__ = ["SharedMemoryVecEnv"]
