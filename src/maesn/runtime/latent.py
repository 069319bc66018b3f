"""The latent of the present task, and how it moves along its policy gradient."""

from dataclasses import dataclass

import numpy as np

from maesn.runtime.arrays import LARGEST, FloatArray


@dataclass(frozen=True)
class Latent:
    """The distribution q(z) = N(mean, diag(exp(log_std)^2)) that z is drawn from.

    Attributes:
        mean: `[latent]`.
        log_std: logarithm of the standard deviation, `[latent]`.

    Raises:
        ValueError: what is drawn from it, or the next update, would not be finite.
    """

    mean: FloatArray
    log_std: FloatArray

    def __post_init__(self) -> None:
        with np.errstate(over="ignore"):
            std = self.std
        fits = (np.abs(self.mean) <= LARGEST) & (std > 0) & (std <= LARGEST)
        if not fits.all():
            raise ValueError(
                f"the latent must have a mean of at most {LARGEST:g} in size and a standard "
                f"deviation above 0 and up to that, got {self.mean} and {std}."
            )

    @property
    def std(self) -> FloatArray:
        """Standard deviation of z, `[latent]`."""
        return np.exp(self.log_std)

    def draw(self, noise: FloatArray) -> FloatArray:
        """Return z = mean + std * noise."""
        return self.mean + self.std * noise

    def within(self, max_norm: float) -> "Latent":
        """Return the latent with its mean shortened to a Euclidean norm of at most `max_norm`."""
        norm = float(np.linalg.norm(self.mean))
        return self if norm <= max_norm else Latent(self.mean * (max_norm / norm), self.log_std)


@dataclass(frozen=True)
class LearningRule:
    """How recorded episodes move the latent: all numbers come from meta-training.

    Attributes:
        mean_step: learned step size of each component of the mean, `[latent]`.
        log_std_step: learned step size of each component of the log standard deviation.
        full_steps: number of updates with the whole step size.
        factor: what the step size is multiplied by in every later update.
        discount: gamma, the weight of a reward one step later.
        ridge: weight of the squared coefficients in the fit of the baseline.
    """

    mean_step: FloatArray
    log_std_step: FloatArray
    full_steps: int
    factor: float
    discount: float
    ridge: float

    def __post_init__(self) -> None:
        for name, fits, wanted in (
            ("full_steps", self.full_steps >= 1, "at least 1"),
            ("factor", 0 < self.factor <= 1, "above 0 and at most 1"),
            ("discount", 0 <= self.discount <= 1, "from 0 to 1"),
            ("ridge", 0 < self.ridge < np.inf, "positive and finite"),
        ):
            if not fits:
                raise ValueError(f"`{name}` must be {wanted}, got {getattr(self, name)}.")

    def scale(self, update: int) -> float:
        """Return what the step sizes are multiplied by in update number 0, 1, ...

        With two full steps and a factor of 1/2 that is 1, 1, 1/2, 1/4, ...
        """
        return float(self.factor ** max(update - (self.full_steps - 1), 0))

    def step(self, latent: Latent, drawn: FloatArray, advantage: FloatArray, update: int) -> Latent:
        """Follow the likelihood-ratio gradient of the return once, in closed form.

            g_mean    = mean_e[A_e (z_e - mean) / std^2]
            g_log_std = mean_e[A_e ((z_e - mean)^2 / std^2 - 1)],    e in [1, E]
            mean' = mean + scale * mean_step * g_mean,  and likewise for log_std

        elementwise per component of the latent (equations (4) and (5), with the gradient of
        section "Using the Latent Spaces for Exploration"). z_e is `[episode, latent]`, the
        standardised A_e `[episode]`; updates count from 0.
        """
        deviation = (drawn - latent.mean) / latent.std
        slope_mean = (advantage @ deviation) / (advantage.shape[0] * latent.std)
        slope_log_std = advantage @ (deviation**2 - 1.0) / advantage.shape[0]
        scale = self.scale(update)
        return Latent(
            latent.mean + scale * self.mean_step * slope_mean,
            latent.log_std + scale * self.log_std_step * slope_log_std,
        )
