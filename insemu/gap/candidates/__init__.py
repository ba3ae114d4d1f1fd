"""What could be missing: candidates for a log at rest, shapes and processes for a drive or flight."""

from insemu.gap.candidates import bias_steps
from insemu.gap.candidates.axis import CANDIDATES, AxisHypothesis, AxisState, best_of, register
from insemu.gap.candidates.bias_steps import paid_for_start, starts_at_rest, step_of_blocks
from insemu.gap.candidates.counts import held_samples, output_counts, saturation
from insemu.gap.candidates.noise import (
    bias_nats,
    flicker,
    gauss_markov,
    mean_spread,
    quantization_noise,
    random_walk,
    white_noise,
)
from insemu.gap.candidates.outliers import outliers
from insemu.gap.candidates.spectral import decimation_filter, vibration_band, vibration_line
from insemu.gap.candidates.telegraph import telegraph
from insemu.gap.candidates.thermal import ramp, temperature

__all__ = [
    "CANDIDATES",
    "AxisHypothesis",
    "AxisState",
    "best_of",
    "bias_nats",
    "mean_spread",
    "paid_for_start",
    "register",
    "starts_at_rest",
    "step_of_blocks",
]

register("white_noise", white_noise)
register("random_walk", random_walk)
register("gauss_markov", gauss_markov)
register("flicker", flicker)
register("quantization", quantization_noise)
register("ramp", ramp)
register("bias_step", bias_steps.at_rest)
register("vibration_band", vibration_band)
register("decimation_filter", decimation_filter)
register("temperature", temperature)
register("saturation", saturation)
register("vibration_line", vibration_line)
register("outliers", outliers)
register("telegraph", telegraph)
register("quantization_output", output_counts)
register("dropped_samples", held_samples)
