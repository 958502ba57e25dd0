"""Clusters as threads make them in a colour space, and the comparisons that clustering is held against."""

import numpy as np


def blobs(counts: list[int], seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Elongated clusters, as colours of one thread under its shading are: features (texel, 4) and truth."""
    rng = np.random.default_rng(seed)
    centres = np.array([[0, 0, 0, 3], [3, 0, 0, 0], [0, 3, 0, 0], [0, 0, -3, 0]], float)
    features, truth = [], []
    for k, count in enumerate(counts):
        features.append(rng.normal(size=(count, 4)) * [0.2, 0.2, 0.6, 0.3] + centres[k])
        truth += [k] * count
    return np.concatenate(features), np.array(truth)


def agreement(labels: np.ndarray, truth: np.ndarray) -> float:
    """Share of texels that are right, with each found region named by its majority."""
    return sum(np.bincount(truth[labels == k]).max() for k in np.unique(labels)) / len(truth)


def expectation_maximisation(features: np.ndarray, labels: np.ndarray, count: int, rounds: int = 40) -> np.ndarray:
    """Labels of a mixture of Gaussians with full covariances, by expectation maximisation from labels."""
    d = features.shape[1]
    R = np.eye(count)[labels]
    for _ in range(rounds):
        sizes = R.sum(0) + 1e-9
        score = np.empty((len(features), count))
        for k in range(count):
            mean = R[:, k] @ features / sizes[k]
            x = features - mean
            covariance = (x * R[:, k : k + 1]).T @ x / sizes[k] + 1e-4 * np.eye(d)
            distance = np.einsum("ti,ti->t", x @ np.linalg.inv(covariance), x)
            score[:, k] = -0.5 * (distance + np.linalg.slogdet(covariance)[1]) + np.log(sizes[k] / len(features))
        R = np.exp(score - score.max(1, keepdims=True))
        R /= R.sum(1, keepdims=True)
    return R.argmax(1)
