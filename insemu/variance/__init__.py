"""Variances and spectra of signals, all with intervals; where a model is needed it comes as an autocovariance or spectrum."""

from insemu.variance.allan import AllanVariance, allan_variance, relative_error
from insemu.variance.covariance import level1_autocovariance, model_covariance, model_edof, wv_covariance
from insemu.variance.reading import Reading, read_curve
from insemu.variance.robust import RobustWaveletVariance, compare_with_robust, robust_wavelet_variance
from insemu.variance.spectrum import (
    Autocorrelation,
    Spectrum,
    autocorrelation,
    average_frequencies,
    average_octaves,
    octave_psd,
    psd,
)
from insemu.variance.wavelet import WaveletVariance, stream_wavelet_variance, wavelet_coefficients, wavelet_variance

__all__ = [
    "AllanVariance",
    "Autocorrelation",
    "Reading",
    "RobustWaveletVariance",
    "Spectrum",
    "WaveletVariance",
    "allan_variance",
    "autocorrelation",
    "average_frequencies",
    "average_octaves",
    "compare_with_robust",
    "level1_autocovariance",
    "model_covariance",
    "model_edof",
    "octave_psd",
    "psd",
    "read_curve",
    "relative_error",
    "robust_wavelet_variance",
    "stream_wavelet_variance",
    "wavelet_coefficients",
    "wavelet_variance",
    "wv_covariance",
]
