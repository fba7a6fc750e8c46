"""Sources of uncertainty of all channels of all poses, each as the factor F of its covariance F Fᵀ."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray

Kind = Literal["prediction", "measurement"]


@dataclass(frozen=True, eq=False)
class Source:
    """One source of uncertainty.

    Attributes:
        name: what it is, in words.
        kind: whether it belongs to the prediction or to the measurement.
        factor: (N, K) F of the covariance F Fᵀ of ln of the N channels: one column an error that they share.
    """

    name: str
    kind: Kind
    factor: FloatArray

    def covariance(self) -> FloatArray:
        """(N, N) covariance of ln of the channels."""
        return np.asarray(self.factor @ self.factor.T)


def shared(name: str, kind: Kind, error: FloatArray) -> Source:
    """One error that moves all channels, (N,), together."""
    return Source(name, kind, np.asarray(error)[:, None])


def of_each(name: str, kind: Kind, u: FloatArray) -> Source:
    """An error of every channel of every pose, (N,), for itself."""
    return Source(name, kind, np.diag(u))


def of_poses(name: str, kind: Kind, u: FloatArray, channels: int = 3) -> Source:
    """An error of every pose that its channels share; (P, channels) standard uncertainties."""
    values = np.asarray(u, dtype=np.float64)
    poses = len(values)
    factor = np.zeros((poses, channels, poses))
    factor[np.arange(poses), :, np.arange(poses)] = values
    return Source(name, kind, factor.reshape(poses * channels, poses))


def of_channels(name: str, kind: Kind, u: FloatArray) -> Source:
    """An error of every channel that all poses share; (P, channels) standard uncertainties."""
    poses, channels = u.shape
    factor = np.zeros((poses, channels, channels))
    factor[:, np.arange(channels), np.arange(channels)] = u
    return Source(name, kind, factor.reshape(poses * channels, channels))


def total(sources: Iterable[Source], count: int) -> FloatArray:
    """(N, N) covariance of all sources together."""
    found = np.zeros((count, count))
    for source in sources:
        found += source.covariance()
    return found
