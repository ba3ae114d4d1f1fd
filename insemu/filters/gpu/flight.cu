// One flight of the loosely coupled filter per warp: the compiled loop of insemu/filters/kernel.py for fixes at known times, stated again for a GPU.
//
// The covariance lives in shared memory as a dense square E of 15 + m rows: nine navigation errors, the six errors of the measured axes during this
// step, the m augmented states. Rows of augmented states hold no columns of navigation errors: the matrix is symmetric, and those are read from above.
// A step is scalar work of one lane (mechanization, coefficients of the map) and work on columns or rows that all lanes share. With one lane and without
// synchronisation the same text is plain C++, which is how it is tested where there is no GPU. Constants of the Earth are put before this text.

#ifdef __CUDACC__
#define DEVICE __device__ __forceinline__
#define LANES 32
#define SYNC __syncwarp()
#else
#include <cmath>
using namespace std;
#define DEVICE static inline
#define LANES 1
#define SYNC
#endif
#define NEVER 1e300  // s, later than any epoch
#define EACH(i, count) for (int i = lane; i < (count); i += LANES)

typedef long long Int;

DEVICE double wrapped(double angle) {
  if (angle > PI) return angle - 2.0 * PI;
  return angle < -PI ? angle + 2.0 * PI : angle;
}

DEVICE void radii(double s, double& rm, double& rn) {
  const double x = 1.0 - E2 * s * s;
  rn = A / sqrt(x);
  rm = rn * (1.0 - E2) / x;
}

DEVICE double gravity_of(double s, double h, int code) {
  const double s2 = s * s, gamma = GAMMA * (1.0 + K_SOMIGLIANA * s2) / sqrt(1.0 - E2 * s2);
  if (code == 1) return gamma * (1.0 - 2.0 * h / A);
  return gamma * (1.0 - 2.0 * h / A * (1.0 + F + M_RATIO - 2.0 * F * s2) + 3.0 * h * h / (A * A));
}

DEVICE void gravity_slopes(double s, double c, double h, int code, double& by_lat, double& by_h) {
  const double s2 = s * s, x = 1.0 - E2 * s2, gamma = GAMMA * (1.0 + K_SOMIGLIANA * s2) / sqrt(x);
  const double d_gamma = gamma * (2.0 * K_SOMIGLIANA / (1.0 + K_SOMIGLIANA * s2) + E2 / x) * s * c;
  if (code == 1) {
    by_lat = d_gamma * (1.0 - 2.0 * h / A);
    by_h = -2.0 * gamma / A;
    return;
  }
  const double p = 1.0 + F + M_RATIO - 2.0 * F * s2, factor = 1.0 - 2.0 * h / A * p + 3.0 * h * h / (A * A);
  by_lat = d_gamma * factor + gamma * 8.0 * F * h / A * s * c;
  by_h = gamma * (-2.0 / A * p + 6.0 * h / (A * A));
}

DEVICE void half_trig(double phi2, double& c, double& s) {
  if (phi2 < 0.02) {
    const double x = 0.25 * phi2;
    c = 1.0 - x * (0.5 - x * (1.0 / 24.0 - x * (1.0 / 720.0 - x / 40320.0)));
    s = 0.5 * (1.0 - x * (1.0 / 6.0 - x * (1.0 / 120.0 - x * (1.0 / 5040.0 - x / 362880.0))));
    return;
  }
  const double angle = sqrt(phi2);
  c = cos(0.5 * angle);
  s = sin(0.5 * angle) / angle;
}

DEVICE void dcm(const double* q, double C[3][3]) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  C[0][0] = w * w + x * x - y * y - z * z;
  C[0][1] = 2.0 * (x * y - w * z);
  C[0][2] = 2.0 * (x * z + w * y);
  C[1][0] = 2.0 * (x * y + w * z);
  C[1][1] = w * w - x * x + y * y - z * z;
  C[1][2] = 2.0 * (y * z - w * x);
  C[2][0] = 2.0 * (x * z - w * y);
  C[2][1] = 2.0 * (y * z + w * x);
  C[2][2] = w * w - x * x - y * y + z * z;
}

DEVICE void cross(const double* a, const double* b, double* out) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

// insemu.strapdown.step
DEVICE void step(double* nav, const double* a, const double* u, const double* a1, const double* u1, double dt, double dt1, int code) {
  const double lat = nav[0], lon = nav[1], h = nav[2], vn = nav[3], ve = nav[4], vd = nav[5];
  const double qw = nav[6], qx = nav[7], qy = nav[8], qz = nav[9];
  const double ratio = dt / dt1, c = ratio > 5.0 ? 0.0 : ratio * ratio / (6.0 * (1.0 + ratio));
  double coned[3];
  cross(a1, a, coned);
  const double fx = a[0] + c * coned[0], fy = a[1] + c * coned[1], fz = a[2] + c * coned[2];

  const double h_mid = h - 0.5 * vd * dt, d = 0.5 * vn * dt / (6.37e6 + h), s0 = sin(lat), c0 = cos(lat);
  const double sl = s0 + d * (c0 - 0.5 * d * s0), cl = c0 - d * (s0 + 0.5 * d * c0);
  double rm, rn;
  radii(sl, rm, rn);
  const double im = 1.0 / (rm + h_mid), ie = 1.0 / (rn + h_mid), tan_ = sl / cl, g = gravity_of(sl, h_mid, code);
  const double en = RATE * cl, ed = -RATE * sl;
  double tn = ve * ie, te = -vn * im, td = -tn * tan_;

  double zx = (en + tn) * dt, zy = te * dt, zz = (ed + td) * dt;
  double tx = zy * qz - zz * qy + qw * zx, ty = zz * qx - zx * qz + qw * zy, tz = zx * qy - zy * qx + qw * zz;
  double rx = a[0] - (zx + 2.0 * (ty * qz - tz * qy));
  double ry = a[1] - (zy + 2.0 * (tz * qx - tx * qz));
  double rz = a[2] - (zz + 2.0 * (tx * qy - ty * qx));

  const double a2 = rx * rx + ry * ry + rz * rz;
  double k1, k2;
  if (a2 < 0.02) {
    k1 = 0.5 - a2 * (1.0 / 24.0 - a2 * (1.0 / 720.0 - a2 * (1.0 / 40320.0 - a2 / 3628800.0)));
    k2 = 1.0 / 6.0 - a2 * (1.0 / 120.0 - a2 * (1.0 / 5040.0 - a2 * (1.0 / 362880.0 - a2 / 39916800.0)));
  } else {
    const double angle = sqrt(a2);
    k1 = (1.0 - cos(angle)) / a2;
    k2 = (angle - sin(angle)) / (a2 * angle);
  }
  const double xx = ry * u[2] - rz * u[1], xy = rz * u[0] - rx * u[2], xz = rx * u[1] - ry * u[0];
  double p[3], w[3];
  cross(a1, u, p);
  cross(u1, a, w);
  const double sx = u[0] + k1 * xx + k2 * (ry * xz - rz * xy) + c * (p[0] + w[0]);
  const double sy = u[1] + k1 * xy + k2 * (rz * xx - rx * xz) + c * (p[1] + w[1]);
  const double sz = u[2] + k1 * xz + k2 * (rx * xy - ry * xx) + c * (p[2] + w[2]);

  tx = qy * sz - qz * sy + qw * sx;
  ty = qz * sx - qx * sz + qw * sy;
  tz = qx * sy - qy * sx + qw * sz;
  const double gx = sx + 2.0 * (qy * tz - qz * ty), gy = sy + 2.0 * (qz * tx - qx * tz), gz = sz + 2.0 * (qx * ty - qy * tx);

  double on = 2.0 * en + tn, oe = te, od = 2.0 * ed + td;
  const double vn_mid = vn + 0.5 * (gx - dt * (oe * vd - od * ve));
  const double ve_mid = ve + 0.5 * (gy - dt * (od * vn - on * vd));
  const double vd_mid = vd + 0.5 * (gz + dt * (g - (on * ve - oe * vn)));
  tn = ve_mid * ie;
  te = -vn_mid * im;
  td = -tn * tan_;
  on = 2.0 * en + tn;
  oe = te;
  od = 2.0 * ed + td;
  zx = (en + tn) * dt;
  zy = te * dt;
  zz = (ed + td) * dt;
  const double vn1 = vn + gx - dt * (oe * vd_mid - od * ve_mid);
  const double ve1 = ve + gy - dt * (od * vn_mid - on * vd_mid);
  const double vd1 = vd + gz - dt * (on * ve_mid - oe * vn_mid) + g * dt;

  const double dlat = 0.5 * dt * (vn + vn1) * im + nav[10], dlon = 0.5 * dt * (ve + ve1) * ie / cl + nav[11];
  const double dh = -0.5 * dt * (vd + vd1) + nav[12], lat1 = lat + dlat, lon1 = lon + dlon, h1 = h + dh;
  nav[10] = dlat - (lat1 - lat);
  nav[11] = dlon - (lon1 - lon);
  nav[12] = dh - (h1 - h);
  nav[0] = lat1;
  nav[1] = wrapped(lon1);
  nav[2] = h1;
  nav[3] = vn1;
  nav[4] = ve1;
  nav[5] = vd1;

  tx = zy * qz - zz * qy + qw * zx;
  ty = zz * qx - zx * qz + qw * zy;
  tz = zx * qy - zy * qx + qw * zz;
  double ex = zx + 2.0 * (ty * qz - tz * qy), ey = zy + 2.0 * (tz * qx - tx * qz), ez = zz + 2.0 * (tx * qy - ty * qx);
  double cw, cs, zw, zs;
  half_trig(fx * fx + fy * fy + fz * fz, cw, cs);
  const double bx = cs * fx, by = cs * fy, bz = cs * fz;
  half_trig(ex * ex + ey * ey + ez * ez, zw, zs);
  ex *= zs;
  ey *= zs;
  ez *= zs;
  const double dx = zw * bx - cw * ex - (ey * bz - ez * by), dy = zw * by - cw * ey - (ez * bx - ex * bz);
  const double dz = zw * bz - cw * ez - (ex * by - ey * bx), dw = zw * cw + ex * bx + ey * by + ez * bz;
  const double less = -(dx * dx + dy * dy + dz * dz) / (1.0 + dw);
  double nw = qw + (qw * less - qx * dx - qy * dy - qz * dz);
  rx = qx + (qw * dx + qx * less + qy * dz - qz * dy);
  ry = qy + (qw * dy - qx * dz + qy * less + qz * dx);
  rz = qz + (qw * dz + qx * dy - qy * dx + qz * less);
  const double lacking = 0.5 * (1.0 - (nw * nw + rx * rx + ry * ry + rz * rz));
  if (fabs(lacking) > 1e-15) {
    nw += lacking * nw;
    rx += lacking * rx;
    ry += lacking * ry;
    rz += lacking * rz;
  }
  nav[6] = nw;
  nav[7] = rx;
  nav[8] = ry;
  nav[9] = rz;
}

// insemu.strapdown.correct, and what rounding leaves of the change of the place
DEVICE void take_off(double* nav, const double* dx) {
  double rm, rn, c, s;
  radii(sin(nav[0]), rm, rn);
  const double lat = nav[0], lon = nav[1], h = nav[2], east = (rn + h) * cos(lat);
  nav[1] -= dx[1] / east;
  nav[0] -= dx[0] / (rm + h);
  nav[2] += dx[2];
  for (int i = 0; i < 3; i++) nav[3 + i] -= dx[3 + i];
  half_trig(dx[6] * dx[6] + dx[7] * dx[7] + dx[8] * dx[8], c, s);
  const double bx = -s * dx[6], by = -s * dx[7], bz = -s * dx[8], w = nav[6], x = nav[7], y = nav[8], z = nav[9];
  nav[6] = c * w - bx * x - by * y - bz * z;
  nav[7] = c * x + bx * w + by * z - bz * y;
  nav[8] = c * y - bx * z + by * w + bz * x;
  nav[9] = c * z + bx * y - by * x + bz * w;
  nav[10] += -dx[0] / (rm + h) - (nav[0] - lat);
  nav[11] += -dx[1] / east - (nav[1] - lon);
  nav[12] += dx[2] - (nav[2] - h);
}

// insemu.strapdown.fill_dynamics and insemu.filters.expanded.fill_map in one: coefficients of the map of a step of dt seconds
DEVICE void fill_map(const double* nav, const double* f, const double mid[3][3], double dt, int code, double* w) {
  const double h = nav[2], vn = nav[3], ve = nav[4], vd = nav[5], sl = sin(nav[0]), cl = cos(nav[0]);
  double rm, rn, g_lat, g_h;
  radii(sl, rm, rn);
  const double x = 1.0 - E2 * sl * sl, rm_lat = 3.0 * rm * E2 * sl * cl / x, rn_lat = rn * E2 * sl * cl / x;
  const double m = 1.0 / (rm + h), e = 1.0 / (rn + h), tan_ = sl / cl, slope = rn_lat * cl - sl / e;
  const double en_n = -RATE * sl * m, ed_n = -RATE * cl * m, tn = ve * e, te = -vn * m, td = -tn * tan_;
  const double tn_n = -tn * e * rn_lat * m, tn_d = tn * e, tn_ve = e, te_n = -te * m * rm_lat * m, te_d = te * m, te_vn = -m;
  const double td_n = -tn_n * tan_ - tn / (cl * cl) * m, td_d = -tn_d * tan_, td_ve = -e * tan_;
  const double on = 2.0 * RATE * cl + tn, oe = te, od = -2.0 * RATE * sl + td;
  const double wn = RATE * cl + tn, we = te, wd = -RATE * sl + td, n_n = 2.0 * en_n + tn_n, d_n = 2.0 * ed_n + td_n;
  gravity_slopes(sl, cl, h, code, g_lat, g_h);
  w[0] = dt * wd;
  w[1] = -dt * we;
  w[2] = -dt * wd;
  w[3] = dt * wn;
  w[4] = dt * we;
  w[5] = -dt * wn;
  w[6] = dt * (-en_n - tn_n);
  w[7] = -dt * te_n;
  w[8] = dt * (-ed_n - td_n);
  w[9] = -dt * tn_d;
  w[10] = -dt * te_d;
  w[11] = -dt * td_d;
  w[12] = -dt * te_vn;
  w[13] = -dt * tn_ve;
  w[14] = -dt * td_ve;
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) w[15 + 3 * i + j] = dt * mid[i][j];
  const double half = 0.5 * dt;
  w[24] = half * f[2];
  w[25] = -half * f[1];
  w[26] = half * f[0];
  w[27] = 1.0 - dt * (te_vn * vd);
  w[28] = dt * (od + td_ve * ve);
  w[29] = -dt * oe;
  w[30] = -dt * od;
  w[31] = 1.0 - dt * (td_ve * vn - tn_ve * vd);
  w[32] = dt * on;
  w[33] = dt * (oe + te_vn * vn);
  w[34] = dt * (-on - tn_ve * ve);
  w[35] = -dt * (te_n * vd - d_n * ve);
  w[36] = -dt * (d_n * vn - n_n * vd);
  w[37] = dt * (g_lat * m - (n_n * ve - te_n * vn));
  w[38] = -dt * (te_d * vd - td_d * ve);
  w[39] = -dt * (td_d * vn - tn_d * vd);
  w[40] = dt * (-g_h - (tn_d * ve - te_d * vn));
  w[41] = 1.0 - dt * vd * m;
  w[42] = dt * vn * m;
  w[43] = -dt * ve * slope * e / cl * m;
  w[44] = 1.0 + dt * (slope * vn * m - cl * vd) * e / cl;
  w[45] = dt * ve * e;
}

// insemu.filters.expanded.apply_map on one column (at E, apart by stride) of fifteen numbers
DEVICE void apply_map(const double* w, double half, double* E, int stride) {
  const double pn = E[0], pe = E[stride], pd = E[2 * stride], vn = E[3 * stride], ve = E[4 * stride], vd = E[5 * stride];
  const double an = E[6 * stride], ae = E[7 * stride], ad = E[8 * stride];
  const double gx = E[9 * stride], gy = E[10 * stride], gz = E[11 * stride], ax = E[12 * stride], ay = E[13 * stride], az = E[14 * stride];
  const double an1 = an + w[0] * ae + w[1] * ad + w[6] * pn + w[9] * pd + w[13] * ve + w[15] * gx + w[16] * gy + w[17] * gz;
  const double ae1 = ae + w[2] * an + w[3] * ad + w[7] * pn + w[10] * pd + w[12] * vn + w[18] * gx + w[19] * gy + w[20] * gz;
  const double ad1 = ad + w[4] * an + w[5] * ae + w[8] * pn + w[11] * pd + w[14] * ve + w[21] * gx + w[22] * gy + w[23] * gz;
  const double sn = an + an1, se = ae + ae1, sd = ad + ad1, fz = w[24], fy = w[25], fx = w[26];
  const double vn1 = w[27] * vn + w[28] * ve + w[29] * vd + w[35] * pn + w[38] * pd + fz * se + fy * sd + w[15] * ax + w[16] * ay + w[17] * az;
  const double ve1 = w[30] * vn + w[31] * ve + w[32] * vd + w[36] * pn + w[39] * pd - fz * sn + fx * sd + w[18] * ax + w[19] * ay + w[20] * az;
  const double vd1 = vd + w[33] * vn + w[34] * ve + w[37] * pn + w[40] * pd - fy * sn - fx * se + w[21] * ax + w[22] * ay + w[23] * az;
  E[0] = w[41] * pn + w[42] * pd + half * (vn + vn1);
  E[stride] = w[43] * pn + w[44] * pe + w[45] * pd + half * (ve + ve1);
  E[2 * stride] = pd + half * (vd + vd1);
  E[3 * stride] = vn1;
  E[4 * stride] = ve1;
  E[5 * stride] = vd1;
  E[6 * stride] = an1;
  E[7 * stride] = ae1;
  E[8 * stride] = ad1;
}

// insemu.filters.measurements.fill_rate; past holds the rates of the last around + 2 steps, imu and t are those of the whole record
DEVICE void fill_rate(const double* t, const double* imu, int width, int N, const double* seen, const double* past, int k, double tau, int around,
                      double* out) {
  const int window = around + 2, first = k - 2 < around ? k - 2 : around, last = N - 1 - k;
  const int before = first > 0 ? first : 0, after = last < around ? last : around;
  const double dt = t[k] - t[k - 1];
  double share = (2.0 + 0.5 * before - tau / dt) / (2.0 + 0.5 * (before + after));
  if (after == 0) share = 0.0;
  if (before == 0) share = 1.0;
  for (int i = 0; i < 3; i++) {
    if (before + after == 0) {
      out[i] = past[k % window * 3 + i];
      continue;
    }
    out[i] = 0.0;
    for (int j = 0; j < before; j++) out[i] += (1.0 - share) * past[(k - 2 - j) % window * 3 + i] / before;
    if (after > 0) {
      double total = 0.0;
      for (int j = 0; j < after; j++) total += imu[(Int)(k + 1 + j) * width + i];
      out[i] += share * (total / (t[k + after] - t[k]) - seen[i]);
    }
  }
}

// insemu.filters.measurements.motion_change: the rate's part alone is needed without states of the latency
DEVICE void rate_change(const double* dx, const double* c, const int* axis, int m, double* change) {
  for (int i = 0; i < 3; i++) change[i] = 0.0;
  for (int s = 0; s < m; s++)
    if (axis[s] >= 0 && axis[s] < 3) change[axis[s]] += c[s] * dx[9 + s];
}

// insemu.filters.measurements.fill_fix without states of the latency; H (6, n) is zero at the start, own is from fill_rate
DEVICE void fill_fix(const double* nav, const double* before, double dt, double tau, const double* rate, const double* rate1, const double* lever,
                     const double* white, const double* c, const int* axis, int m, int lever_at, const double* own, const double* z, double* nu,
                     double* H, int n, double* R) {
  double C[3][3], rm, rn, acc[3], omega[3], turn[3], arm[3], swing[3], omega_n[3], twice[3];
  dcm(nav + 6, C);
  radii(sin(nav[0]), rm, rn);
  const double h = nav[2], we_n = RATE * cos(nav[0]), we_d = -RATE * sin(nav[0]), shift = (0.5 * dt - fmin(tau, dt)) / dt;
  for (int i = 0; i < 3; i++) {
    acc[i] = (nav[3 + i] - before[3 + i]) / dt;
    omega[i] = rate[i] + shift * (rate[i] - rate1[i]);
    omega[i] = omega[i] - C[0][i] * we_n - C[2][i] * we_d;
  }
  cross(omega, lever, turn);
  for (int i = 0; i < 3; i++) {
    arm[i] = C[i][0] * lever[0] + C[i][1] * lever[1] + C[i][2] * lever[2];
    swing[i] = C[i][0] * turn[0] + C[i][1] * turn[1] + C[i][2] * turn[2];
    omega_n[i] = C[i][0] * omega[0] + C[i][1] * omega[1] + C[i][2] * omega[2];
  }
  cross(omega_n, swing, twice);
  // the arm goes back by the mean rate since the fix
  double a[3], s[3], more[3], turned[3];
  for (int i = 0; i < 3; i++) more[i] = 0.5 * fmin(tau, dt) / dt * (rate[i] - rate1[i]);
  cross(more, lever, turned);
  for (int i = 0; i < 3; i++) {
    a[i] = arm[i] - tau * (swing[i] + C[i][0] * turned[0] + C[i][1] * turned[1] + C[i][2] * turned[2]);
    s[i] = swing[i] - tau * twice[i];
  }
  const double half = 0.5 * tau * tau;
  nu[0] = (z[0] - nav[0] - nav[10]) * (rm + h) - (a[0] - tau * nav[3] + half * acc[0]);
  nu[1] = wrapped(z[1] - nav[1] - nav[11]) * (rn + h) * cos(nav[0]) - (a[1] - tau * nav[4] + half * acc[1]);
  nu[2] = h - z[2] + nav[12] - (a[2] - tau * nav[5] + half * acc[2]);
  for (int i = 0; i < 3; i++) nu[3 + i] = z[3 + i] - (nav[3 + i] - tau * acc[i] + s[i]);
  for (int i = 0; i < 36; i++) R[i] = 0.0;
  for (int i = 0; i < 3; i++) {
    H[i * n + i] = 1.0;
    H[i * n + 3 + i] = -tau;
    H[(3 + i) * n + 3 + i] = 1.0;
  }
  H[7] = a[2];
  H[8] = -a[1];
  H[n + 6] = -a[2];
  H[n + 8] = a[0];
  H[2 * n + 6] = a[1];
  H[2 * n + 7] = -a[0];
  const double f0 = tau * acc[0], f1 = tau * acc[1], f2 = tau * (acc[2] - 9.81);
  H[3 * n + 7] = s[2] - f2;
  H[3 * n + 8] = f1 - s[1];
  H[4 * n + 6] = f2 - s[2];
  H[4 * n + 8] = s[0] - f0;
  H[5 * n + 6] = s[1] - f1;
  H[5 * n + 7] = f0 - s[0];
  if (lever[0] != 0.0 || lever[1] != 0.0 || lever[2] != 0.0) {
    double X[3][3];
    for (int i = 0; i < 3; i++) {
      double column[3];
      cross(C[i], lever, column);
      for (int j = 0; j < 3; j++) X[i][j] = -column[j];
    }
    for (int k = 0; k < m; k++)
      if (axis[k] >= 0 && axis[k] < 3)
        for (int i = 0; i < 3; i++) {
          H[(3 + i) * n + 9 + k] = -X[i][axis[k]] * c[k];
          H[i * n + 9 + k] = tau * X[i][axis[k]] * c[k];
        }
    const double spread = (1.0 + shift) * (1.0 + shift) + shift * shift;
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        for (int k = 0; k < 3; k++) R[(3 + i) * 6 + 3 + j] += spread * white[k] * X[i][k] * X[j][k];
  }
  if (lever_at >= 0) {
    for (int i = 0; i < 3; i++) omega[i] = own[i] - C[0][i] * we_n - C[2][i] * we_d;
    for (int i = 0; i < 3; i++) omega_n[i] = C[i][0] * omega[0] + C[i][1] * omega[1] + C[i][2] * omega[2];
    for (int j = 0; j < 3; j++) {
      double M[3], carried[3];
      for (int i = 0; i < 3; i++) M[i] = C[i][(j + 1) % 3] * omega[(j + 2) % 3] - C[i][(j + 2) % 3] * omega[(j + 1) % 3];
      cross(omega_n, M, carried);
      for (int i = 0; i < 3; i++) {
        H[i * n + lever_at + j] = C[i][j] - tau * M[i];
        H[(3 + i) * n + lever_at + j] = M[i] - tau * carried[i];
      }
    }
  }
}

// Element (i, j) of the filter's covariance in the layout's order
DEVICE double& at(double* E, int ld, int i, int j) {
  const int a = i <= j ? i : j, b = i <= j ? j : i;
  return E[(a < 9 ? a : a + 6) * ld + (b < 9 ? b : b + 6)];
}

DEVICE void put(double* E, int ld, int i, int j, double x) {
  at(E, ld, i, j) = x;
  if ((i < 9) == (j < 9)) E[((i > j ? i : j) + (i < 9 ? 0 : 6)) * ld + (i > j ? j : i) + (i < 9 ? 0 : 6)] = x;
}

// insemu.filters.measurements.first_bad_pivot
DEVICE int first_bad_pivot(double* E, int ld, int n, double* L, int lane) {
  for (int j = 0; j < n; j++) {
    const double variance = at(E, ld, j, j);
    double pivot = variance;
    for (int k = 0; k < j; k++) pivot -= L[j * n + k] * L[j * n + k];
    if (!(variance >= 0.0) || pivot < -1e-9 * variance) return j;
    const bool flat = pivot <= 1e-13 * variance;
    const double root = flat ? 1.0 : sqrt(pivot);
    SYNC;
    for (int i = j + lane; i < n; i += LANES) {
      double x = i == j ? root * root : at(E, ld, j, i);
      if (i > j)
        for (int k = 0; k < j; k++) x -= L[i * n + k] * L[j * n + k];
      L[i * n + j] = flat ? 0.0 : x / root;
    }
    SYNC;
  }
  return -1;
}

struct Design {
  int n, diagonal, gravity, lever_at, every, output_every, nnz, entries, around;
};

// Doubles of working space of one flight: insemu.filters.gpu.pool_size
DEVICE double* cut(double*& pool, int size) {
  double* out = pool;
  pool += size;
  return out;
}

DEVICE void predict(double* E, int ld, int m, const Design& o, const int* phi_row, const int* phi_col, const double* phi, const int* q_row,
                    const int* q_col, const double* q, const int* axis, const double* c, const double* white, const double* w, double half,
                    double* W, int lane) {
  double* aug = E + 15 * ld + 15;  // the square of the augmented states
  if (o.diagonal) {
    EACH(e, (9 + m) * m) {
      const int i = e / m, j = e % m;
      if (i < 9)
        E[i * ld + 15 + j] *= phi[j];
      else
        aug[(i - 9) * ld + j] *= phi[i - 9] * phi[j];
    }
    SYNC;
  } else {
    EACH(e, m * m) {
      double total = 0.0;
      for (int k = phi_row[e / m]; k < phi_row[e / m + 1]; k++) total += phi[k] * aug[phi_col[k] * ld + e % m];
      W[e] = total;
    }
    SYNC;
    EACH(e, m * m) {
      double total = 0.0;
      for (int k = phi_row[e % m]; k < phi_row[e % m + 1]; k++) total += W[e / m * m + phi_col[k]] * phi[k];
      aug[e / m * ld + e % m] = total;
    }
    SYNC;
    EACH(e, 9 * m) {
      double total = 0.0;
      for (int k = phi_row[e % m]; k < phi_row[e % m + 1]; k++) total += E[e / m * ld + 15 + phi_col[k]] * phi[k];
      W[e] = total;
    }
    SYNC;
    EACH(e, 9 * m) E[e / m * ld + 15 + e % m] = W[e];
    SYNC;
  }
  EACH(e, o.entries) aug[q_row[e] * ld + q_col[e]] += q[e];
  SYNC;
  EACH(j, m) {
    double u[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    for (int s = 0; s < m; s++) {
      const double x = c[s] * aug[s * ld + j];
      for (int a = 0; a < 6; a++)
        if (axis[s] == a) u[a] -= x;
    }
    for (int a = 0; a < 6; a++) E[(9 + a) * ld + 15 + j] = u[a];
  }
  SYNC;
  EACH(i, 15) {
    double u[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    for (int s = 0; s < m; s++) {
      const double x = c[s] * E[i * ld + 15 + s];
      for (int a = 0; a < 6; a++)
        if (axis[s] == a) u[a] -= x;
    }
    for (int a = 0; a < 6; a++) {
      if (i == 9 + a) u[a] += white[a];
      E[i * ld + 9 + a] = u[a];
      if (i < 9) E[(9 + a) * ld + i] = u[a];
    }
  }
  SYNC;
  EACH(j, 15 + m) apply_map(w, half, E + j, ld);
  SYNC;
  EACH(i, 9) apply_map(w, half, E + i * ld, 1);
  SYNC;
  EACH(e, 81) {
    const int i = e / 9, j = e % 9;
    if (i < j) E[i * ld + j] = E[j * ld + i];  // of two sums that differ in rounding one is kept
  }
  SYNC;
}

#ifdef __CUDACC__
extern "C" __global__ void fly(
#else
extern "C" void fly(Int flight, double* pool,
#endif
    const int* sizes, const double* t, const int* axis, const int* driver, const int* phi_row, const int* phi_col, const int* q_row, const int* q_col,
    const int* cov_epoch, const double* c0, const double* phi_of, const double* q_of, const double* white, const double* lever0,
    const double* thresholds, const double* timeout, const double* imu_all, const double* nav_all, const double* x_all, const double* P_all, const int* count_all,
    const int* epoch_all, const double* tau_all, const double* z_all, const double* var_all, double* out_nav, double* out_var, double* out_x,
    double* fix_nu, double* fix_S, double* fix_nis, int* fix_dof, int* fix_ok, double* out_P, double* last_P, int* status) {
#ifdef __CUDACC__
  extern __shared__ double pool[];
  const int lane = threadIdx.x;
  const Int flight = blockIdx.x;
#else
  const int lane = 0;
#endif
  const int N = sizes[0], fixes = sizes[1], covariances = sizes[2], rows = sizes[3], width = sizes[12];
  const Design o = {sizes[4], sizes[5], sizes[6], sizes[7], sizes[8], sizes[9], sizes[10], sizes[11], sizes[13]};
  const int n = o.n, m = n - 9, ne = 15 + m, ld = ne | 1;
  double* here = pool;
  double *E = cut(here, ne * ld), *W = cut(here, n * n), *H = cut(here, 6 * n), *G = cut(here, 6 * n), *K = cut(here, 6 * n), *D = cut(here, 6 * n);
  double *nav = cut(here, 13), *before = cut(here, 13), *x = cut(here, m), *moved = cut(here, m), *c = cut(here, m), *dx = cut(here, n);
  double *seen = cut(here, 6), *dth = cut(here, 3), *dv = cut(here, 3), *dth1 = cut(here, 3), *dv1 = cut(here, 3), *rate = cut(here, 3);
  double *rate1 = cut(here, 3), *lever = cut(here, 3), *white_now = cut(here, 6), *w = cut(here, 46), *nu = cut(here, 6), *S = cut(here, 36);
  double *L = cut(here, 36), *R = cut(here, 36), *y = cut(here, 6), *record = cut(here, width * CHUNK), *times = cut(here, CHUNK);
  double *past = cut(here, 3 * (o.around + 2)), *own = cut(here, 3), *change = cut(here, 3);
  const double* imu = imu_all + flight * N * width;
  const double *tau_of = tau_all + flight * fixes, *z_of = z_all + flight * fixes * 6, *var_of = var_all + flight * fixes * 6;
  const int *epoch_of = epoch_all + flight * fixes, count_of = count_all[flight];
  out_nav += flight * rows * 10;
  out_var += flight * rows * n;
  out_x += flight * rows * m;
  fix_nu += flight * fixes * 6;
  fix_S += flight * fixes * 36;
  fix_nis += flight * fixes;
  fix_dof += flight * fixes;
  fix_ok += flight * fixes;
  out_P += flight * covariances * n * n;
  last_P += flight * n * n;
  status += 2 * flight;
  const double* P0 = P_all + flight * n * n;

  EACH(i, ne * ld) E[i] = 0.0;
  SYNC;
  EACH(e, n * n) put(E, ld, e / n, e % n, P0[e]);
  EACH(i, 13) nav[i] = nav_all[flight * 13 + i];
  EACH(s, m) {
    x[s] = x_all[flight * m + s];
    c[s] = c0[s];
  }
  EACH(i, 3) {
    dth[i] = dv[i] = rate[i] = own[i] = 0.0;
    lever[i] = lever0[i];
  }
  if (lane == 0) status[0] = status[1] = 0;
  SYNC;
  int bad = first_bad_pivot(E, ld, n, W, lane);
  if (bad >= 0) {
    if (lane == 0) status[0] = 1, status[1] = bad;
    return;
  }
  double f_sum[3] = {0.0, 0.0, 0.0}, C_sum[3][3] = {{0.0}}, span = 0.0, dt = 0.0, dt1 = 0.0, now = 0.0;
  double rejected_from = NEVER;
  int many = 0, event = 0, cov = 0, row = 0;
  for (int k = 0; k < N; k++) {
    const int r = k % CHUNK;
    if (r == 0) {
      SYNC;
      const int left = N - k < CHUNK ? N - k : CHUNK;
      EACH(i, width * left) record[i] = imu[(Int)k * width + i];
      EACH(i, left) times[i] = t[k + i];
      SYNC;
    }
    const double t_before = now;
    now = times[r];
    const bool measures = event < count_of && epoch_of[event] == k;
    if (k > 0) {
      dt1 = dt;
      dt = now - t_before;
      EACH(s, m) {
        double total = 0.0;
        for (int j = phi_row[s]; j < phi_row[s + 1]; j++) total += phi_of[j] * x[phi_col[j]];
        moved[s] = total;
        if (driver[s] >= 0) c[s] = c0[s] * record[width * r + driver[s]] / dt;
      }
      SYNC;
      EACH(s, m) x[s] = moved[s];
      SYNC;
      EACH(a, 6) {
        double total = 0.0;
        for (int s = 0; s < m; s++)
          if (axis[s] == a) total += c[s] * x[s];
        seen[a] = total;
      }
      SYNC;
      if (o.every > 1)
        span += dt, many++;
      else
        span = dt, many = 1;
      const bool due = measures || many == o.every || k == N - 1 || k % o.every == 0 ||
                       (cov < covariances && cov_epoch[cov] == k);
      if (lane == 0) {
        double C[3][3], mid[3][3], f[3];
        for (int i = 0; i < 3; i++) {
          dth1[i] = dth[i];
          dv1[i] = dv[i];
          rate1[i] = rate[i];
          dth[i] = record[width * r + i] - seen[i] * dt;
          dv[i] = record[width * r + 3 + i] - seen[3 + i] * dt;
          rate[i] = dth[i] / dt;
        }
        if (k == 1)
          for (int i = 0; i < 3; i++) dth1[i] = dth[i], dv1[i] = dv[i], rate1[i] = rate[i];
        for (int i = 0; i < 10; i++) before[i] = nav[i];
        dcm(nav + 6, C);
        const double hx = 0.5 * dth[0], hy = 0.5 * dth[1], hz = 0.5 * dth[2];
        for (int i = 0; i < 3; i++) {
          mid[i][0] = C[i][0] + C[i][1] * hz - C[i][2] * hy;
          mid[i][1] = C[i][1] + C[i][2] * hx - C[i][0] * hz;
          mid[i][2] = C[i][2] + C[i][0] * hy - C[i][1] * hx;
          f[i] = (mid[i][0] * dv[0] + mid[i][1] * dv[1] + mid[i][2] * dv[2]) / dt;
        }
        if (o.every > 1) {
          for (int i = 0; i < 3; i++) {
            f_sum[i] += f[i] * dt;
            for (int j = 0; j < 3; j++) C_sum[i][j] += mid[i][j] * dt;
          }
          if (due)
            for (int i = 0; i < 3; i++) {
              f[i] = f_sum[i] / span;
              f_sum[i] = 0.0;
              for (int j = 0; j < 3; j++) {
                mid[i][j] = C_sum[i][j] / span;
                C_sum[i][j] = 0.0;
              }
            }
        }
        if (due) {
          for (int i = 0; i < 6; i++) white_now[i] = white[i] / many;
          fill_map(nav, f, mid, span, o.gravity, w);
        }
        step(nav, dth, dv, dth1, dv1, dt, k == 1 ? dt : dt1, o.gravity);
        for (int i = 0; i < 3; i++) past[k % (o.around + 2) * 3 + i] = rate[i];
      }
      SYNC;
      if (due) {
        predict(E, ld, m, o, phi_row, phi_col, phi_of + (many - 1) * o.nnz, q_row, q_col, q_of + (many - 1) * o.entries, axis, c, white_now, w,
                0.5 * span, W, lane);
        span = 0.0;
        many = 0;
      }
    }
    for (; event < count_of && epoch_of[event] == k; event++) {
      const double *z = z_of + 6 * event, *var = var_of + 6 * event;
      int used[6], q = 0;
      for (int i = 0; i < 6; i++)
        if (isfinite(z[i]) && isfinite(var[i])) used[q++] = i;
      EACH(i, 6 * n) H[i] = 0.0;
      SYNC;
      if (lane == 0) {
        for (int i = 0; i < 3; i++) lever[i] = lever0[i] + (o.lever_at >= 0 ? x[o.lever_at - 9 + i] : 0.0);
        if (o.lever_at >= 0) fill_rate(t, imu, width, N, seen, past, k, tau_of[event], o.around, own);
        fill_fix(nav, before, dt, tau_of[event], rate, rate1, lever, white, c, axis, m, o.lever_at, own, z, nu, H, n, R);
        for (int a = 0; a < q; a++) {
          R[used[a] * 7] += var[used[a]];
          fix_nu[6 * event + used[a]] = nu[used[a]];
        }
      }
      SYNC;
      EACH(i, n) for (int a = 0; a < q; a++) {
        double total = 0.0;
        for (int j = 0; j < n; j++) total += at(E, ld, i, j) * H[used[a] * n + j];
        G[6 * i + a] = total;
      }
      SYNC;
      EACH(e, q * q) {
        const int a = e / q, b = e % q;
        if (a <= b) {
          double total = R[used[a] * 6 + used[b]];
          for (int j = 0; j < n; j++) total += H[used[a] * n + j] * G[6 * j + b];
          S[6 * a + b] = S[6 * b + a] = total;
          fix_S[36 * event + 6 * used[a] + used[b]] = fix_S[36 * event + 6 * used[b] + used[a]] = total;
        }
      }
      SYNC;
      int wrong = -1;
      double nis = 0.0;
      if (lane == 0) {
        for (int j = 0; j < q && wrong < 0; j++) {
          double pivot = S[7 * j];
          for (int k2 = 0; k2 < j; k2++) pivot -= L[6 * j + k2] * L[6 * j + k2];
          if (!(pivot > 0.0)) {
            wrong = used[j];
            break;
          }
          L[7 * j] = sqrt(pivot);
          for (int i = j + 1; i < q; i++) {
            double v = S[6 * i + j];
            for (int k2 = 0; k2 < j; k2++) v -= L[6 * i + k2] * L[6 * j + k2];
            L[6 * i + j] = v / L[7 * j];
          }
        }
        for (int a = 0; a < q && wrong < 0; a++) {
          double v = nu[used[a]];
          for (int k2 = 0; k2 < a; k2++) v -= L[6 * a + k2] * y[k2];
          y[a] = v / L[7 * a];
          nis += y[a] * y[a];
        }
        y[0] = nis;
        if (wrong >= 0) status[0] = 2, status[1] = wrong;
      }
      SYNC;
      nis = y[0];
#ifdef __CUDACC__
      wrong = __shfl_sync(0xffffffffu, wrong, 0);
#endif
      if (wrong >= 0) return;
      const bool ok = q > 0 && (!(nis > thresholds[q]) || t[k] - rejected_from >= timeout[0]);
      if (q > 0) rejected_from = ok ? NEVER : fmin(rejected_from, t[k]);
      if (lane == 0) {
        if (q > 0) fix_nis[event] = nis;
        fix_dof[event] = q;
        fix_ok[event] = ok ? 1 : 0;
      }
      if (!ok) {
        SYNC;
        continue;
      }
      EACH(i, n) {
        for (int a = 0; a < q; a++) {
          double v = G[6 * i + a];
          for (int k2 = 0; k2 < a; k2++) v -= L[6 * a + k2] * K[6 * i + k2];
          K[6 * i + a] = v / L[7 * a];
        }
        for (int a = q - 1; a >= 0; a--) {
          double v = K[6 * i + a];
          for (int k2 = a + 1; k2 < q; k2++) v -= L[6 * k2 + a] * K[6 * i + k2];
          K[6 * i + a] = v / L[7 * a];
        }
        double off = 0.0;
        for (int a = 0; a < q; a++) off -= K[6 * i + a] * nu[used[a]];
        dx[i] = off;
      }
      SYNC;
      EACH(i, n) {  // (I - K H) P H' - K R, row by row
        double row_[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
        for (int j = 0; j < n; j++) {
          double left = at(E, ld, i, j);
          for (int a = 0; a < q; a++) left -= K[6 * i + a] * G[6 * j + a];
          for (int a = 0; a < q; a++) row_[a] += left * H[used[a] * n + j];
        }
        for (int a = 0; a < q; a++) {
          for (int b = 0; b < q; b++) row_[a] -= K[6 * i + b] * R[used[b] * 6 + used[a]];
          D[6 * i + a] = row_[a];
        }
      }
      SYNC;
      EACH(e, n * n) {
        const int i = e / n, j = e % n;
        if (i <= j) {
          double one = at(E, ld, i, j), other = one;
          for (int a = 0; a < q; a++) {
            one -= K[6 * i + a] * G[6 * j + a];
            other -= K[6 * j + a] * G[6 * i + a];
          }
          double v = 0.5 * (one + other);
          for (int a = 0; a < q; a++) v -= 0.5 * (D[6 * i + a] * K[6 * j + a] + D[6 * j + a] * K[6 * i + a]);
          put(E, ld, i, j, v);
        }
      }
      SYNC;
      if (lane == 0) take_off(nav, dx);
      EACH(s, m) x[s] -= dx[9 + s];
      SYNC;
      if (o.lever_at >= 0) {  // what the fix saw keeps its covariance: insemu.filters.measurements.turn
        EACH(i, 6 * n) D[i] = 0.0;
        SYNC;
        if (lane == 0) {
          take_off(before, dx);
          rate_change(dx, c, axis, m, change);
          for (int i = 0; i < 3; i++) {
            rate[i] += change[i];
            rate1[i] += change[i];
            seen[i] -= change[i];
            own[i] += change[i];
            for (int j = 0; j < o.around + 2; j++) past[3 * j + i] += change[i];
            lever[i] = lever0[i] + x[o.lever_at - 9 + i];
          }
          fill_fix(nav, before, dt, tau_of[event], rate, rate1, lever, white, c, axis, m, o.lever_at, own, z, y, D, n, L);
        }
        SYNC;
        EACH(e, q * n) {
          const int i = used[e / n], j = e % n;
          double total = at(E, ld, i, j);
          for (int s = 6; s < n; s++) total += (H[i * n + s] - D[i * n + s]) * at(E, ld, s, j);
          W[i * n + j] = total;
        }
        SYNC;
        EACH(e, q * n) {
          const int i = used[e / n], j = e % n;
          bool also = false;
          for (int a = 0; a < q; a++) also = also || used[a] == j;
          double total = W[i * n + j];
          if (also)
            for (int s = 6; s < n; s++) total += (H[j * n + s] - D[j * n + s]) * W[i * n + s];
          if (!also || i <= j) put(E, ld, i, j, total);
        }
        SYNC;
      }
      bad = first_bad_pivot(E, ld, n, W, lane);
      if (bad >= 0) {
        if (lane == 0) status[0] = 1, status[1] = bad;
        return;
      }
    }
    if (cov < covariances && cov_epoch[cov] == k) {
      EACH(e, n * n) out_P[(Int)cov * n * n + e] = at(E, ld, e / n, e % n);
      cov++;
    }
    if (k % o.output_every == 0 || k == N - 1) {
      EACH(i, 10) out_nav[(Int)row * 10 + i] = nav[i];
      EACH(i, n) out_var[(Int)row * n + i] = at(E, ld, i, i);
      EACH(s, m) out_x[(Int)row * m + s] = x[s];
      row++;
    }
  }
  bad = first_bad_pivot(E, ld, n, W, lane);
  EACH(e, n * n) last_P[e] = at(E, ld, e / n, e % n);
  if (lane == 0) {
    for (int i = 0; i < 10; i++)
      if (!isfinite(nav[i])) status[0] = 3, status[1] = N - 1;
    if (status[0] == 0 && bad >= 0) status[0] = 1, status[1] = bad;
  }
}
