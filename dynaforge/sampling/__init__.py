"""Collecting with vectorised envs: conditions drawn by stratum, jobs given out to envs, workers in shared memory."""
