"""Variances and spectra of signals, all with intervals; where a model is needed it comes as an autocovariance or spectrum."""

from insemu.variance.covariance import level1_autocovariance, model_covariance, model_edof, wv_covariance
from insemu.variance.wavelet import WaveletVariance, stream_wavelet_variance, wavelet_coefficients, wavelet_variance

__all__ = [
    "WaveletVariance",
    "level1_autocovariance",
    "model_covariance",
    "model_edof",
    "stream_wavelet_variance",
    "wavelet_coefficients",
    "wavelet_variance",
    "wv_covariance",
]
