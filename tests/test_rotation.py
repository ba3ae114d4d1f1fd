import numpy as np
from scipy.spatial.transform import Rotation

from insemu import rotation

rng = np.random.default_rng(5)
RPY = np.column_stack([rng.uniform(-np.pi, np.pi, 200), rng.uniform(-1.57, 1.57, 200), rng.uniform(-np.pi, np.pi, 200)])


def theirs(rpy):
    return Rotation.from_euler("ZYX", np.asarray(rpy)[..., ::-1])


def test_dcm_agrees_with_scipy_and_returns():
    np.testing.assert_allclose(rotation.dcm_from_rpy(RPY), theirs(RPY).as_matrix(), atol=1e-15)
    np.testing.assert_allclose(rotation.rpy_from_dcm(rotation.dcm_from_rpy(RPY)), RPY, atol=1e-12)


def test_quaternion_agrees_with_dcm():
    q = rotation.quaternion_from_rpy(RPY)
    np.testing.assert_allclose(rotation.dcm_from_quaternion(q), rotation.dcm_from_rpy(RPY), atol=1e-14)
    back = rotation.quaternion_from_dcm(rotation.dcm_from_rpy(RPY))
    np.testing.assert_allclose(back * np.sign((back * q).sum(-1, keepdims=True)), q, atol=1e-14)
    c = np.empty((3, 3))
    rotation.scalar_dcm(q[3], c)
    np.testing.assert_allclose(c, rotation.dcm_from_rpy(RPY[3]), atol=1e-14)


def test_quaternion_of_half_turns():
    for axis in np.eye(3):
        c = 2 * np.outer(axis, axis) - np.eye(3)
        np.testing.assert_allclose(rotation.dcm_from_quaternion(rotation.quaternion_from_dcm(c)), c, atol=1e-15)


def test_product_is_composition():
    p, q = rotation.quaternion_from_rpy(RPY[:100]), rotation.quaternion_from_rpy(RPY[100:])
    np.testing.assert_allclose(
        rotation.dcm_from_quaternion(rotation.quaternion_product(p, q)),
        rotation.dcm_from_rpy(RPY[:100]) @ rotation.dcm_from_rpy(RPY[100:]),
        atol=1e-14,
    )


def test_exp_and_log_agree_with_scipy_at_every_size():
    for size in (0.0, 1e-13, 1e-9, 1e-4, 0.1, 1.0, 3.0):
        phi = rng.normal(size=3)
        phi *= size / np.linalg.norm(phi)
        np.testing.assert_allclose(rotation.dcm_from_vector(phi), Rotation.from_rotvec(phi).as_matrix(), atol=1e-15)
        np.testing.assert_allclose(rotation.vector_from_dcm(rotation.dcm_from_vector(phi)), phi, rtol=1e-7, atol=1e-16)
        np.testing.assert_allclose(
            rotation.vector_from_quaternion(rotation.quaternion_from_vector(phi)), phi, rtol=1e-14, atol=1e-30
        )


def test_compiled_half_angle_is_exact_on_both_branches():
    for angle in (0.0, 1e-8, 1e-3, 0.1, 0.1414, 0.142, 2.0):
        c, s = rotation.scalar_half_trig(angle * angle)
        np.testing.assert_allclose(c, np.cos(angle / 2), rtol=3e-16)
        np.testing.assert_allclose(s, 0.5 * np.sinc(angle / 2 / np.pi), rtol=3e-16)


def test_attitude_difference_has_the_house_sign():
    phi = np.array([1e-5, -2e-5, 3e-5])
    estimate = rotation.rpy_from_dcm((np.eye(3) + rotation.skew(phi)) @ rotation.dcm_from_rpy(RPY[7]))
    np.testing.assert_allclose(rotation.attitude_difference(estimate, RPY[7]), phi, atol=1e-9)


def test_skew_is_the_cross_product():
    a, b = rng.normal(size=(2, 3))
    np.testing.assert_allclose(rotation.skew(a) @ b, np.cross(a, b), atol=1e-15)
