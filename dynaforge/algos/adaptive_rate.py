"""A learning rate that follows the KL divergence of the updates."""

from __future__ import annotations

STEP = 1.5  # by what the rate changes after an update outside the band
BAND = 2.0  # the band reaches from the desired KL over this to the desired KL times this
SMALLEST = 0.01  # of the scheduled rate


def followed(factor: float, kl: float, desired_kl: float) -> float:
    """Return the factor on the learning rate for the next update.

    After an update that went too far the rate falls by 1.5, after one that hardly moved it rises by 1.5, as with the
    adaptive schedules of RSL-RL (`desired_kl`, Rudin et al. 2021) and skrl (`KLAdaptiveLR`). Those adapt within an
    update, at every minibatch or epoch, and to fixed bounds. Here the KL is that of a whole update, and the scheduled
    rate is the upper bound, so that a rate which decays to zero still does.

    Args:
        factor: That of the update, at most 1.
        kl: KL(old || new) of the update, mean over its transitions.
        desired_kl: What it should have been, within a factor of 2.
    """
    if kl > BAND * desired_kl:
        factor /= STEP
    elif kl < desired_kl / BAND:
        factor *= STEP
    return min(1.0, max(SMALLEST, factor))
