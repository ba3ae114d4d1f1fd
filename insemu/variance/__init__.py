"""Variances and spectra of signals, all with intervals; where a model is needed it comes as an autocovariance or spectrum."""

from insemu.variance import findings
from insemu.variance.allan import AllanVariance, allan_variance, relative_error
from insemu.variance.characterise import AxisReport, characterise, characterise_stream, duration, grouped_findings
from insemu.variance.covariance import level1_autocovariance, model_covariance, model_edof, wv_covariance
from insemu.variance.cross import WaveletCovariance, wavelet_covariance
from insemu.variance.edof import chi_square_interval, correlated_octaves, eta3
from insemu.variance.filtered import curve_address, expected_variance, filter_covariance
from insemu.variance.filters import modwt_filters
from insemu.variance.findings import longest_good_part, missing_values, unit_report
from insemu.variance.reading import FLICKER, Reading, read_curve
from insemu.variance.robust import RobustWaveletVariance, compare_with_robust, robust_wavelet_variance
from insemu.variance.same import SameModel, same_model
from insemu.variance.spectrum import (
    Autocorrelation,
    Spectrum,
    autocorrelation,
    average_frequencies,
    average_octaves,
    octave_psd,
    psd,
)
from insemu.variance.wavelet import (
    HaarAccumulator,
    WaveletVariance,
    curve_of_moments,
    stream_wavelet_variance,
    wavelet_coefficients,
    wavelet_variance,
)

__all__ = [
    "FLICKER",
    "AllanVariance",
    "Autocorrelation",
    "AxisReport",
    "HaarAccumulator",
    "Reading",
    "RobustWaveletVariance",
    "SameModel",
    "Spectrum",
    "WaveletCovariance",
    "WaveletVariance",
    "allan_variance",
    "autocorrelation",
    "average_frequencies",
    "average_octaves",
    "characterise",
    "characterise_stream",
    "chi_square_interval",
    "compare_with_robust",
    "correlated_octaves",
    "curve_address",
    "curve_of_moments",
    "duration",
    "eta3",
    "expected_variance",
    "filter_covariance",
    "findings",
    "grouped_findings",
    "level1_autocovariance",
    "longest_good_part",
    "missing_values",
    "model_covariance",
    "model_edof",
    "modwt_filters",
    "octave_psd",
    "psd",
    "read_curve",
    "relative_error",
    "robust_wavelet_variance",
    "same_model",
    "stream_wavelet_variance",
    "unit_report",
    "wavelet_coefficients",
    "wavelet_covariance",
    "wavelet_variance",
    "wv_covariance",
]
