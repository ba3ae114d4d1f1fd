"""Compensation is the emulator backwards: what an effect did to ideal data is taken off again."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from insemu import earth
from insemu.effects import EffectUse, compensated, effect_of, lever_arm_of
from insemu.emulate import built_in, corrupt, gnss_fixes, ideal_imu
from insemu.errors import InputError
from insemu.records import Recording

EFFECTS = {
    "scale_factor": {"sensor": "gyro", "value": [3e-3, -2e-3, 5e-3]},
    "scale_asymmetry": {"sensor": "accel", "value": [3e-3, -2e-3, 5e-3]},
    "scale_nonlinearity": {"sensor": "accel", "K2": [1e-4, 0, 2e-4], "K3": [1e-5, 0, 0]},
    "misalignment": {"sensor": "accel", "value": [1e-3, -2e-3, 3e-3, 4e-3, -5e-3, 6e-3]},
    "g_sensitivity": {"value": [1e-5 * k for k in range(9)]},
    "turn_on_bias": {"sensor": "gyro", "value": [1e-3, 2e-3, -3e-3]},
    "temperature": {"sensor": "accel", "c1": [1e-3, 0, 2e-3], "c2": [1e-5, 0, 0], "c3": [0, 1e-6, 0], "lag": 20.0},
    "ramp": {"sensor": "gyro", "R": [1e-6, 0, -2e-6]},
    "mounting": {"rpy": [0.1, -0.2, 2.0]},
    "imu_gnss_time_offset": {"offset": 0.05},
    "clock_drift": {"drift": 1e-3},
    "earth_rate": {},
    "transport_rate": {},
    "gravity": {"offset": 0.01},
}


@functools.cache
def ideal(kind: str = "increment"):
    made = ideal_imu(built_in("lemniscate"), 50.0, span=(0.0, 60.0), kind=kind, mode="continuous")
    return made.imu, made.reference


def use(effect: str, **values: object) -> EffectUse:
    return EffectUse.from_mapping({"effect": effect, **values})


@pytest.mark.parametrize("kind", ["increment", "sample"])
@pytest.mark.parametrize("effect", EFFECTS)
def test_taking_an_effect_off_undoes_the_emulator(effect: str, kind: str) -> None:
    imu, reference = ideal(kind)
    temperature = 20.0 + 0.2 * imu.t
    it = use(effect, **EFFECTS[effect])
    made = corrupt(imu, None, np.random.default_rng(1), effects=[it], reference=reference, temperature=temperature).imu
    assert (
        max(np.abs(made.gyro - imu.gyro).max(), np.abs(made.accel - imu.accel).max(), np.abs(made.t - imu.t).max())
        > 1e-9
    )
    back = compensated(Recording(made), [it], trajectory=reference).imu
    size = max(np.abs(made.gyro - imu.gyro).max(), np.abs(made.accel - imu.accel).max(), 1e-9)
    np.testing.assert_allclose(back.t, imu.t, atol=1e-9)
    np.testing.assert_allclose(back.gyro, imu.gyro, atol=1e-6 * size)
    np.testing.assert_allclose(back.accel, imu.accel, atol=1e-6 * size)


def test_effects_together_are_taken_off_in_the_order_of_the_signal_chain() -> None:
    imu, reference = ideal()
    together = [use(name, **values) for name, values in EFFECTS.items()]
    temperature = 20.0 + 0.2 * imu.t
    rng = np.random.default_rng(1)
    made = corrupt(imu, None, rng, effects=together[::-1], reference=reference, temperature=temperature).imu
    back = compensated(Recording(made), together, trajectory=reference).imu
    # asymmetry and non-linearity are solved by substitution, whose error is the square of their size
    np.testing.assert_allclose(back.gyro, imu.gyro, atol=2e-3 * np.abs(made.gyro - imu.gyro).max())
    np.testing.assert_allclose(back.accel, imu.accel, atol=2e-3 * np.abs(made.accel - imu.accel).max())


def test_fixes_are_put_right() -> None:
    _, reference = ideal()

    def fixes(*effects: EffectUse):
        return gnss_fixes(reference, 1.0, (0.1,) * 3, (0.05,) * 3, rng=np.random.default_rng(2), effects=effects)

    plain = fixes()
    step = use("gnss_multipath_step", value=[1.0, -2.0, 3.0], start=20.0, duration=10.0)
    back = compensated(Recording(ideal()[0], fixes(step)), [step]).gnss
    # radii differ over the step by 1e-6 of it
    assert np.abs(earth.position_difference(back.llh, plain.llh)).max() < 1e-5
    level = use("gnss_noise_level", factor=[2.0, 3.0, 4.0])
    np.testing.assert_allclose(compensated(Recording(ideal()[0], plain), [level]).gnss.pos_std_ned[0], [0.2, 0.3, 0.4])
    velocity = use("gnss_velocity_noise", factor=[2.0, 2.0, 2.0], sigma=[0.0, 0.0, 0.1], tau=10.0)
    got = compensated(Recording(ideal()[0], plain), [velocity]).gnss.vel_std_ned[0]
    np.testing.assert_allclose(got, [0.1, 0.1, np.hypot(0.1, 0.1)])
    late = use("gnss_latency", latency=0.2)
    np.testing.assert_allclose(compensated(Recording(ideal()[0], plain), [late]).gnss.t, plain.t - 0.2)
    np.testing.assert_allclose(lever_arm_of([use("lever_arm", value=[0.1, 0, 0])], [1, 2, 3]), [1.1, 2, 3])


def test_what_is_missing_is_said() -> None:
    imu, _ = ideal()
    with pytest.raises(InputError, match="none was recorded"):
        compensated(Recording(imu), [use("temperature", sensor="gyro", c1=1e-3)])
    with pytest.raises(InputError, match="none is given"):
        compensated(Recording(imu), [use("earth_rate")])
    assert not effect_of("outliers").compensable


def test_the_motion_is_estimated_only_where_an_effect_needs_it() -> None:
    imu, reference = ideal()
    asked = []

    def estimate(recording: Recording):
        asked.append(recording)
        return reference

    bias = use("turn_on_bias", sensor="gyro", value=[1e-3, 0.0, 0.0])
    compensated(Recording(imu), [bias], trajectory=estimate)
    assert asked == []
    compensated(Recording(imu), [bias, use("earth_rate", **EFFECTS["earth_rate"])], trajectory=estimate)
    assert len(asked) == 1
