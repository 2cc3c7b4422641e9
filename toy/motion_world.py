r"""A Gaussian process of poses over time, of which predictions have a known law at each horizon.

Each coordinate of each joint is a stationary Gauss–Markov process about a rest pose, of standard deviation σ and
correlation ρ from one frame to the next. After an observed pose the law of the clip that follows is Gaussian,

.. math:: x_t - b \mid x_0 \sim N\big(ρ^t (x_0 - b),\; σ^2 (1 - ρ^{2t})\big), \qquad
    \operatorname{cov}(x_s, x_t \mid x_0) = σ^2 (ρ^{|t - s|} - ρ^{t + s})

so that coverage, spread and energy scores at each horizon, and that of the whole clip, are exact: oracles of posecal's
numbers by horizon. A forecast is of the same family, with another correlation, a wrong spread, or frames that are drawn
without regard to each other.

References
----------
Uhlenbeck and Ornstein, Phys. Rev. 36, 823 (1930).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import integrate

from posecal.errors import PoseDataError
from toy import curves

__all__ = ["Forecast", "MotionWorld", "mean_norm"]

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Forecast:
    """How hypotheses of a clip are drawn, after an observed pose.

    Attributes
    ----------
    correlation : float or None
        From one frame to the next; that of the world by default.
    spread : float
        By which deviations from the mean are multiplied.
    is_motion : bool
        Whether a hypothesis is one motion through the clip; else its frames are drawn without regard to each other.
    """

    correlation: float | None = None
    spread: float = 1.0
    is_motion: bool = True


@dataclass(frozen=True)
class MotionWorld:
    """Clips of a Gauss–Markov process of poses, and the exact numbers of forecasts of them.

    Attributes
    ----------
    joints : int
        K.
    frames : int
        T.
    correlation : float
        ρ, from one frame to the next.
    sigma : float
        σ, mm.

    Raises
    ------
    PoseDataError
        For a correlation that is not between 0 and 1, and numbers below 1.

    Examples
    --------
    At a correlation of 0.8 and σ = 100 mm, the spread is 60 mm after one frame and tends to 100 mm.

    >>> MotionWorld(frames=3, correlation=0.8).deviations(Forecast()).round(1).tolist()
    [60.0, 76.8, 85.9]
    """

    joints: int = 6
    frames: int = 25
    correlation: float = 0.9
    sigma: float = 100.0

    def __post_init__(self) -> None:
        if not 0 < self.correlation < 1 or min(self.joints, self.frames) < 1 or self.sigma <= 0:
            raise PoseDataError(
                f"correlation {self.correlation:g}, {self.joints} joints, {self.frames} frames, σ = {self.sigma:g}; "
                "expected a correlation between 0 and 1, and positive numbers."
            )

    @property
    def rest(self) -> Floats:
        """The rest pose, (K, 3), mm: joints 250 mm apart along a line."""
        return np.asarray(250.0 * np.arange(self.joints)[:, None] * np.array([0.0, 0.6, 0.8]))

    def sample(self, clips: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Draw observed poses (C, K, 3), and the clips (C, T, K, 3) that follow them, mm."""
        observed = self.sigma * rng.standard_normal((clips, self.joints, 3))
        return observed + self.rest, self._draw(Forecast(), observed[None], rng)[0] + self.rest

    def predict(self, forecast: Forecast, observed: Floats, N: int, rng: np.random.Generator) -> Floats:
        """Draw hypotheses (N, C, T, K, 3) of the clips that follow observed poses (C, K, 3), mm."""
        start = np.broadcast_to(observed - self.rest, (N, *observed.shape))
        return self._draw(forecast, start, rng) + self.rest

    def deviations(self, forecast: Forecast) -> Floats:
        """Give the standard deviation of a coordinate of the hypotheses at each horizon, (T,), mm."""
        return forecast.spread * np.sqrt(np.diag(self._covariance(self._correlation(forecast))))

    def coverage(self, forecast: Forecast, level: float, N: int | None = None) -> Floats:
        """Give the share of truths within the ball that holds a share of the hypotheses, at each horizon, (T,).

        For N hypotheses and exchangeable ranks, or infinitely many by default. The ball is of one joint.
        """
        errors = np.sqrt(np.diag(self._errors(forecast)))
        found = []
        for spread in self.deviations(forecast) / errors:
            of_level = np.array([level])
            exact = (
                curves.coverage(of_level, spread=spread)
                if N is None
                else curves.coverage_of(N, of_level, spread=spread)
            )
            found.append(float(exact[0]))
        return np.array(found)

    def frame_energies(self, forecast: Forecast) -> Floats:
        """Give the energy score of the whole pose at each horizon, (T,), mm."""
        spread, errors = self.deviations(forecast) ** 2, np.diag(self._errors(forecast))
        d = 3 * self.joints
        of_normal = math.sqrt(2) * math.exp(math.lgamma((d + 1) / 2) - math.lgamma(d / 2))
        return of_normal * (np.sqrt(spread + errors) - np.sqrt(spread / 2))

    def clip_energy(self, forecast: Forecast) -> float:
        """Give the energy score of the whole clip, mm."""
        spread = forecast.spread**2 * self._covariance(self._correlation(forecast))
        if not forecast.is_motion:
            spread = np.diag(np.diag(spread))
        d = 3 * self.joints
        return mean_norm(spread + self._errors(forecast), d) - mean_norm(2 * spread, d) / 2

    def _correlation(self, forecast: Forecast) -> float:
        return self.correlation if forecast.correlation is None else forecast.correlation

    def _covariance(self, correlation: float) -> Floats:
        """Covariance of a coordinate over the frames of a clip, given the observed one, (T, T)."""
        t = np.arange(1, self.frames + 1)
        return np.asarray(self.sigma**2 * (correlation ** np.abs(t[:, None] - t) - correlation ** (t[:, None] + t)))

    def _errors(self, forecast: Forecast) -> Floats:
        """Covariance of a coordinate of the truth minus the mean of the hypotheses, over all clips, (T, T)."""
        t = np.arange(1, self.frames + 1)
        off = self.sigma * (self.correlation**t - self._correlation(forecast) ** t)  # times a standard normal pose
        return self._covariance(self.correlation) + off[:, None] * off

    def _draw(self, forecast: Forecast, start: Floats, rng: np.random.Generator) -> Floats:
        """Draw deviations from the rest pose after others (N, C, K, 3), as (N, C, T, K, 3)."""
        correlation = self._correlation(forecast)
        mean = start[:, :, None] * (correlation ** np.arange(1, self.frames + 1))[:, None, None]
        noise = rng.standard_normal(mean.shape)
        covariance = self._covariance(correlation)
        factor = np.linalg.cholesky(covariance) if forecast.is_motion else np.diag(np.sqrt(np.diag(covariance)))
        return np.asarray(mean + forecast.spread * np.einsum("st,nctkd->ncskd", factor, noise))


def mean_norm(covariance: Floats, copies: int) -> float:
    r"""Mean norm of a Gaussian vector of mean 0, of independent copies of one of a given covariance.

    .. math:: E \lVert z \rVert = \frac{1}{\sqrt{π}} \int_0^\infty
        \frac{1 - \prod_i (1 + 2 u^2 λ_i)^{-d/2}}{u^2} du

    for eigenvalues λ and d copies.

    Parameters
    ----------
    covariance : array (T, T)
        Of one copy.
    copies : int
        d.

    Returns
    -------
    float
        By quadrature.

    References
    ----------
    Mathai and Provost, Quadratic Forms in Random Variables (1992), section 3.2b.

    Examples
    --------
    In three dimensions it is √(8/π).

    >>> round(mean_norm(np.eye(1), 3), 6), round(math.sqrt(8 / math.pi), 6)
    (1.595769, 1.595769)
    """
    values = np.linalg.eigvalsh(covariance).clip(min=0)
    scale = float(copies * values.sum())

    def integrand(u: float) -> float:
        return float(-np.expm1(-copies / 2 * np.log1p(2 * u * u * values / scale).sum()) / (u * u))

    return math.sqrt(scale / math.pi) * float(integrate.quad(integrand, 0, np.inf, limit=200)[0])
