"""`onboard.detector: boundary_tensor`: energy of edges, lines and corners, thresholded where it is line-like.

Köthe 2003, "Integrated edge and junction detection with the boundary tensor" (ICCV, 424): ``B = T_even T_even^T +
T_odd T_odd^T``, T_even the Hessian of a Gaussian, T_odd its quadrature partner; Köthe 2006 ("Low-level feature detection using
the boundary tensor") gives the separable form used here: the odd filter's radial part |w| exp(-s^2 w^2/2) is replaced by
(a + b w^2) exp(-s^2 w^2/2), first and third derivatives of a Gaussian. As a debris detector: Vives Vallduriola et al. 2018,
Int. J. Remote Sensing 39, 8002.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.detect import components, whiten
from onboard.detect.single_frame import SingleFrameDetector
from sboc_e2e.icd.signals import Detection, DetectorView


def gaussian_derivatives(scale_px: float) -> tuple[NDArray[np.float64], ...]:
    """Sampled Gaussian of the given sigma and its first three derivatives (correlation kernels), shape (2 r + 1,)."""
    x = np.arange(-int(np.ceil(4.0 * scale_px)), int(np.ceil(4.0 * scale_px)) + 1, dtype=np.float64)
    variance = scale_px**2
    g = np.exp(-0.5 * x * x / variance)
    g /= g.sum()
    return g, x / variance * g, (x * x / variance - 1.0) / variance * g, (x**3 / variance**2 - 3.0 * x / variance) / variance * g


def quadrature_weights(scale_px: float) -> tuple[float, float]:
    """(a, b) of the least-squares fit of |w| by a + b w^2 under the radial power w^3 exp(-s^2 w^2) of a gradient filter."""
    w = np.linspace(0.0, 6.0 / scale_px, 2001)
    weight = w**3 * np.exp(-((scale_px * w) ** 2))
    basis = np.stack([np.ones_like(w), w * w]) * np.sqrt(weight)
    solution, *_ = np.linalg.lstsq(basis.T, w * np.sqrt(weight), rcond=None)
    return float(solution[0]), float(solution[1])


def boundary_tensor(
    image: NDArray[np.float32], scale_px: float
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Components (rr, rc, cc) of the boundary tensor, each (rows, cols), in squared units of the image per px^4."""
    g, d1, d2, d3 = gaussian_derivatives(scale_px)
    a, b = quadrature_weights(scale_px)

    def filtered(along_cols: NDArray[np.float64], along_rows: NDArray[np.float64]) -> NDArray[np.float32]:
        return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, along_cols, along_rows, borderType=cv2.BORDER_REFLECT), np.float32)

    even_rr, even_rc, even_cc = filtered(g, d2), filtered(d1, d1), filtered(d2, g)
    # i w_r (a + b |w|^2): a d/dr - b d/dr (d2/dr2 + d2/dc2)
    odd_r = a * filtered(g, d1) - b * (filtered(g, d3) + filtered(d2, d1))
    odd_c = a * filtered(d1, g) - b * (filtered(d3, g) + filtered(d1, d2))
    return (
        even_rr**2 + even_rc**2 + odd_r**2,
        even_rc * (even_rr + even_cc) + odd_r * odd_c,
        even_cc**2 + even_rc**2 + odd_c**2,
    )


@dataclass(frozen=True, kw_only=True)
class BoundaryTensorDetector(SingleFrameDetector):
    """Components of pixels whose line-like boundary energy stands above that of the noise."""

    scale_px: float = field(default=1.5, metadata={"doc": "sigma of the tensor's Gaussian", "min": 0.5, "max": 20.0})
    n_sigma: float = field(
        default=5.0, metadata={"doc": "threshold in robust deviations of the root energy", "min": 1.0, "max": 100.0}
    )
    min_length_px: float = field(default=10.0, metadata={"doc": "least length", "min": 2.0, "max": 1000.0})
    min_axis_ratio: float = field(default=2.5, metadata={"doc": "least ratio of the axes", "min": 1.0, "max": 100.0})
    min_snr: float = field(default=7.0, metadata={"doc": "least matched-filter S/N", "min": 0.0, "max": 1000.0})

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Detections by falling S/N."""
        masked = components.masked_image(view, self.halo_px)
        image = masked.image.astype(np.float32) / np.float32(whiten.UNIT)
        rr, rc, cc = boundary_tensor(image, self.scale_px)
        line_energy = np.sqrt(np.hypot(rr - cc, 2.0 * rc))
        sample = line_energy[::7, ::7]
        centre = float(np.median(sample))
        deviation = 1.4826 * float(np.median(np.abs(sample - centre)))
        if not deviation > 0.0:
            return ()
        segments = components.elongated_components(
            line_energy > centre + self.n_sigma * deviation, min_length_px=self.min_length_px, min_axis_ratio=self.min_axis_ratio
        )
        joined = components.join_collinear(segments, gap_px=20.0, across_px=3.0)
        return components.to_detections(
            masked, joined, psf_sigma_px=view.psf_sigma_px, min_snr=self.min_snr, max_detections=self.max_detections
        )
