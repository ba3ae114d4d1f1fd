"""Variances and spectra of signals, all with intervals; where a model is needed it comes as an autocovariance or spectrum."""

from insemu.variance.covariance import level1_autocovariance, model_covariance, model_edof, wv_covariance
from insemu.variance.robust import RobustWaveletVariance, compare_with_robust, robust_wavelet_variance
from insemu.variance.wavelet import WaveletVariance, stream_wavelet_variance, wavelet_coefficients, wavelet_variance

__all__ = [
    "RobustWaveletVariance",
    "WaveletVariance",
    "compare_with_robust",
    "level1_autocovariance",
    "model_covariance",
    "model_edof",
    "robust_wavelet_variance",
    "stream_wavelet_variance",
    "wavelet_coefficients",
    "wavelet_variance",
    "wv_covariance",
]
