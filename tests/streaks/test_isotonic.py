"""Isotonic regression against scipy's."""

import numpy as np
from scipy.optimize import isotonic_regression

from ground.isotonic import never_falling, never_rising


def test_it_gives_the_same_bytes_as_scipy() -> None:
    rng = np.random.default_rng(11)
    for n in [1, 2, 3] * 20 + list(range(4, 200)):
        values = np.round(rng.normal(0.0, 2.0, n) + rng.choice([-0.1, 0.0, 0.1]) * np.arange(n), int(rng.integers(0, 6)))
        weights = rng.choice([1e-30, 1.0, 1.0, 3.0], n) * rng.uniform(0.5, 2.0, n)
        kept = values.copy(), weights.copy()
        rising = isotonic_regression(values, weights=weights).x
        falling = isotonic_regression(values, weights=weights, increasing=False).x
        assert never_falling(values, weights).tobytes() == np.ascontiguousarray(rising).tobytes()
        assert never_rising(values, weights).tobytes() == np.ascontiguousarray(falling).tobytes()
        assert np.array_equal(values, kept[0])
        assert np.array_equal(weights, kept[1])
