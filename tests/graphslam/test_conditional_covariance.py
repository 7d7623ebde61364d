"""The covariance of what an error is beside some directions of it."""

import numpy as np

from graphslam.arrays import conditional_covariance


def test_the_conditional_covariance_is_the_limit_for_a_singular_one() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(6, 6)) * np.array([1e-4, 1.0, 1e3, 1.0, 10.0, 0.1])[:, None]
    basis = rng.normal(size=(6, 2))
    regular = root @ root.T
    inside = np.linalg.inv(basis.T @ np.linalg.inv(regular) @ basis)
    found = conditional_covariance(regular, basis)
    scale = np.sqrt(np.diag(regular))
    expected = regular - basis @ inside @ basis.T
    assert np.allclose(found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-9)
    for singular in (root[:, :4] @ root[:, :4].T, np.zeros((6, 6)), np.diag((1.0, 0, 2, 0, 3, 0))):
        lifted = singular + 1e-9 * np.eye(6)
        limit = lifted - basis @ np.linalg.inv(basis.T @ np.linalg.inv(lifted) @ basis) @ basis.T
        found = conditional_covariance(singular, basis)
        assert np.allclose(found, limit, atol=1e-5 * max(1.0, np.abs(singular).max()))
    first = np.eye(6, 2)
    assert np.allclose(conditional_covariance(np.diag((4.0, 9.0, 1, 0, 0, 2)), first)[:2], 0.0)
