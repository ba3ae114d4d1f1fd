"""Variances and spectra of signals, all with intervals; where a model is needed it comes as an autocovariance or spectrum."""

from insemu.variance.wavelet import WaveletVariance, stream_wavelet_variance, wavelet_coefficients, wavelet_variance

__all__ = ["WaveletVariance", "stream_wavelet_variance", "wavelet_coefficients", "wavelet_variance"]
