// The Runge-Kutta step of a mass/spring body in C: the yardsticks of the rows "ours / C". Compiled by compiled.py with
//     gcc -O3 -march=native -ffast-math -shared -fPIC
//
// Two forms, each in double and float:
//   plain_*     springs one after the other on (n, 3) arrays, as one writes them; the compiler may vectorise what it can.
//   vector_*    AVX-512 by hand: rows [x y z 0 u v w 0]; a first pass turns 8 (16) springs at a time into one coefficient each,
//               a second pass scatters coefficient times difference, a third is the fused Runge-Kutta stage.
// vector_* wants springs padded to whole blocks of 8 (16) without a common node, so that no store waits for the one before.
#include <math.h>
#include <stdint.h>

#define ALWAYS static inline __attribute__((always_inline))

// ---------------------------------------------------------------------------------------------------------------- plain

// One force evaluation and one stage. `tension` is stiffness times rest length.
#define PLAIN(REAL, NAME, ROOT)                                                                                              \
    ALWAYS void NAME##_forces(long n_springs, const uint32_t *restrict first, const uint32_t *restrict second,               \
                              const REAL *restrict stiffness, const REAL *restrict tension, const REAL *restrict damping,    \
                              const REAL *restrict position, const REAL *restrict velocity, REAL *restrict force,            \
                              int is_damped) {                                                                               \
        for (long s = 0; s < n_springs; s++) {                                                                               \
            const long i = 3L * first[s], j = 3L * second[s];                                                                \
            const REAL dx = position[j] - position[i];                                                                       \
            const REAL dy = position[j + 1] - position[i + 1];                                                               \
            const REAL dz = position[j + 2] - position[i + 2];                                                               \
            const REAL inverse = 1 / ROOT(dx * dx + dy * dy + dz * dz);                                                      \
            REAL pull = stiffness[s] - tension[s] * inverse;                                                                 \
            if (is_damped) {                                                                                                 \
                const REAL du = velocity[j] - velocity[i];                                                                   \
                const REAL dv = velocity[j + 1] - velocity[i + 1];                                                           \
                const REAL dw = velocity[j + 2] - velocity[i + 2];                                                           \
                pull += damping[s] * (dx * du + dy * dv + dz * dw) * inverse * inverse;                                      \
            }                                                                                                                \
            force[i] += pull * dx, force[i + 1] += pull * dy, force[i + 2] += pull * dz;                                     \
            force[j] -= pull * dx, force[j + 1] -= pull * dy, force[j + 2] -= pull * dz;                                     \
        }                                                                                                                    \
    }                                                                                                                        \
    ALWAYS void NAME##_stage(int stage, long n, REAL reach, REAL weight, const REAL *restrict inverse_mass,                  \
                             const REAL *restrict gravity, REAL drag, REAL *restrict position, REAL *restrict velocity,      \
                             REAL *restrict there, REAL *restrict speed, REAL *restrict moved, REAL *restrict gained,        \
                             REAL *restrict force) {                                                                         \
        for (long i = 0; i < n; i++) {                                                                                       \
            const REAL slope = stage ? speed[i] : velocity[i];                                                               \
            const REAL acceleration = inverse_mass[i] * force[i] + gravity[i] - drag * slope;                                \
            force[i] = 0;                                                                                                    \
            if (stage == 3) {                                                                                                \
                position[i] += moved[i] + weight * slope;                                                                    \
                velocity[i] += gained[i] + weight * acceleration;                                                            \
            } else {                                                                                                         \
                moved[i] = (stage ? moved[i] : 0) + weight * slope;                                                          \
                gained[i] = (stage ? gained[i] : 0) + weight * acceleration;                                                 \
                there[i] = position[i] + reach * slope;                                                                      \
                speed[i] = velocity[i] + reach * acceleration;                                                               \
            }                                                                                                                \
        }                                                                                                                    \
    }                                                                                                                        \
    ALWAYS void NAME##_steps(long n_steps, REAL step, long n_nodes, long n_springs, const uint32_t *first,                   \
                             const uint32_t *second, const REAL *stiffness, const REAL *tension, const REAL *damping,        \
                             const REAL *inverse_mass, const REAL *gravity, REAL drag, REAL *position, REAL *velocity,       \
                             REAL *there, REAL *speed, REAL *moved, REAL *gained, REAL *force, int is_damped) {              \
        const REAL reach[4] = {step / 2, step / 2, step, 0}, weight[4] = {step / 6, step / 3, step / 3, step / 6};           \
        for (long t = 0; t < n_steps; t++) {                                                                                 \
            _Pragma("GCC unroll 4") for (int stage = 0; stage < 4; stage++) {                                                \
                NAME##_forces(n_springs, first, second, stiffness, tension, damping, stage ? there : position,               \
                              stage ? speed : velocity, force, is_damped);                                                   \
                NAME##_stage(stage, 3 * n_nodes, reach[stage], weight[stage], inverse_mass, gravity, drag, position,         \
                             velocity, there, speed, moved, gained, force);                                                  \
            }                                                                                                                \
        }                                                                                                                    \
    }                                                                                                                        \
    void NAME(long n_steps, REAL step, long n_nodes, long n_springs, const uint32_t *first, const uint32_t *second,          \
              const REAL *stiffness, const REAL *tension, const REAL *damping, const REAL *inverse_mass,                     \
              const REAL *gravity, REAL drag, REAL *position, REAL *velocity, REAL *there, REAL *speed, REAL *moved,         \
              REAL *gained, REAL *force, int is_damped) {                                                                    \
        if (is_damped)                                                                                                       \
            NAME##_steps(n_steps, step, n_nodes, n_springs, first, second, stiffness, tension, damping, inverse_mass,        \
                         gravity, drag, position, velocity, there, speed, moved, gained, force, 1);                          \
        else                                                                                                                 \
            NAME##_steps(n_steps, step, n_nodes, n_springs, first, second, stiffness, tension, damping, inverse_mass,        \
                         gravity, drag, position, velocity, there, speed, moved, gained, force, 0);                          \
    }

PLAIN(double, plain_double, sqrt)
PLAIN(float, plain_float, sqrtf)

// --------------------------------------------------------------------------------------------------------------- vector
#ifdef __AVX512DQ__
#include <immintrin.h>

// 1 / sqrt: by division, or from a 14-bit estimate by Newton's steps; which is faster depends on the processor.
ALWAYS __m512d inverse_root_double(__m512d x, int by_newton) {
    if (!by_newton) return _mm512_div_pd(_mm512_set1_pd(1.0), _mm512_sqrt_pd(x));
    const __m512d half = _mm512_mul_pd(x, _mm512_set1_pd(0.5)), one_and_half = _mm512_set1_pd(1.5);
    __m512d y = _mm512_rsqrt14_pd(x);
    y = _mm512_mul_pd(y, _mm512_fnmadd_pd(_mm512_mul_pd(half, y), y, one_and_half));
    return _mm512_mul_pd(y, _mm512_fnmadd_pd(_mm512_mul_pd(half, y), y, one_and_half));
}

ALWAYS __m512 inverse_root_float(__m512 x, int by_newton) {
    if (!by_newton) return _mm512_div_ps(_mm512_set1_ps(1.0f), _mm512_sqrt_ps(x));
    const __m512 y = _mm512_rsqrt14_ps(x), half = _mm512_mul_ps(x, _mm512_set1_ps(0.5f));
    return _mm512_mul_ps(y, _mm512_fnmadd_ps(_mm512_mul_ps(half, y), y, _mm512_set1_ps(1.5f)));
}

// Sums of neighbours in each 128-bit lane of a, then of b: [a0+a1 b0+b1 ...].
ALWAYS __m512d pair_sums(__m512d a, __m512d b) {
    return _mm512_add_pd(_mm512_unpacklo_pd(a, b), _mm512_unpackhi_pd(a, b));
}

// In each lane, the sums of its four numbers in a, b, c and d: a 4 x 4 transposition that adds.
ALWAYS __m512 lane_sums(__m512 a, __m512 b, __m512 c, __m512 d) {
    const __m512 u = _mm512_add_ps(_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b));
    const __m512 v = _mm512_add_ps(_mm512_unpacklo_ps(c, d), _mm512_unpackhi_ps(c, d));
    return _mm512_add_ps(_mm512_shuffle_ps(u, v, 0x44), _mm512_shuffle_ps(u, v, 0xEE));
}

// Difference of two whole rows.
ALWAYS __m512d row_double(const double *state, const uint32_t *first, const uint32_t *second, long s) {
    return _mm512_sub_pd(_mm512_load_pd(state + 8L * second[s]), _mm512_load_pd(state + 8L * first[s]));
}

// Differences of two positions, springs s and r.
ALWAYS __m512d positions_double(const double *state, const uint32_t *first, const uint32_t *second, long s, long r) {
    const __m256d a = _mm256_sub_pd(_mm256_load_pd(state + 8L * second[s]), _mm256_load_pd(state + 8L * first[s]));
    const __m256d b = _mm256_sub_pd(_mm256_load_pd(state + 8L * second[r]), _mm256_load_pd(state + 8L * first[r]));
    return _mm512_insertf64x4(_mm512_castpd256_pd512(a), b, 1);
}

// Differences of two whole rows, springs s and r.
ALWAYS __m512 rows_float(const float *state, const uint32_t *first, const uint32_t *second, long s, long r) {
    const __m256 a = _mm256_sub_ps(_mm256_load_ps(state + 8L * second[s]), _mm256_load_ps(state + 8L * first[s]));
    const __m256 b = _mm256_sub_ps(_mm256_load_ps(state + 8L * second[r]), _mm256_load_ps(state + 8L * first[r]));
    return _mm512_insertf32x8(_mm512_castps256_ps512(a), b, 1);
}

// Differences of four positions, springs s, s+4, s+8 and s+12.
ALWAYS __m512 positions_float(const float *state, const uint32_t *first, const uint32_t *second, long s) {
    __m512 all = _mm512_setzero_ps();
    __m128 each[4];
    for (int l = 0; l < 4; l++)
        each[l] = _mm_sub_ps(_mm_load_ps(state + 8L * second[s + 4 * l]), _mm_load_ps(state + 8L * first[s + 4 * l]));
    all = _mm512_castps128_ps512(each[0]);
    all = _mm512_insertf32x4(all, each[1], 1);
    all = _mm512_insertf32x4(all, each[2], 2);
    return _mm512_insertf32x4(all, each[3], 3);
}

ALWAYS void coefficients_double(long n, const uint32_t *restrict first, const uint32_t *restrict second,
                                const double *restrict stiffness, const double *restrict tension,
                                const double *restrict damping, const double *restrict state, double *restrict pull,
                                int is_damped, int by_newton) {
    for (long s = 0; s < n; s += 8) {
        __m512d square, dot = _mm512_setzero_pd();
        if (is_damped) {
            __m512d product[8];
#pragma GCC unroll 8
            for (int l = 0; l < 8; l++) {
                const __m512d d = row_double(state, first, second, s + l);
                product[l] = _mm512_mul_pd(d, _mm512_shuffle_f64x2(d, d, 0x44));  // [x y z 0 x y z 0] * [x y z 0 u v w 0]
            }
            const __m512d a = pair_sums(product[0], product[1]), b = pair_sums(product[2], product[3]);
            const __m512d c = pair_sums(product[4], product[5]), d = pair_sums(product[6], product[7]);
            const __m512d low = _mm512_add_pd(_mm512_shuffle_f64x2(a, b, 0x88), _mm512_shuffle_f64x2(a, b, 0xDD));
            const __m512d high = _mm512_add_pd(_mm512_shuffle_f64x2(c, d, 0x88), _mm512_shuffle_f64x2(c, d, 0xDD));
            square = _mm512_shuffle_f64x2(low, high, 0x88);
            dot = _mm512_shuffle_f64x2(low, high, 0xDD);
        } else {
            const __m512d a = positions_double(state, first, second, s, s + 2);
            const __m512d b = positions_double(state, first, second, s + 1, s + 3);
            const __m512d c = positions_double(state, first, second, s + 4, s + 6);
            const __m512d d = positions_double(state, first, second, s + 5, s + 7);
            const __m512d low = pair_sums(_mm512_mul_pd(a, a), _mm512_mul_pd(b, b));
            const __m512d high = pair_sums(_mm512_mul_pd(c, c), _mm512_mul_pd(d, d));
            square = _mm512_add_pd(_mm512_shuffle_f64x2(low, high, 0x88), _mm512_shuffle_f64x2(low, high, 0xDD));
        }
        const __m512d inverse = inverse_root_double(square, by_newton);
        __m512d sum = _mm512_fnmadd_pd(_mm512_load_pd(tension + s), inverse, _mm512_load_pd(stiffness + s));
        if (is_damped)
            sum = _mm512_fmadd_pd(_mm512_mul_pd(_mm512_load_pd(damping + s), dot), _mm512_mul_pd(inverse, inverse), sum);
        _mm512_store_pd(pull + s, sum);
    }
}

ALWAYS void coefficients_float(long n, const uint32_t *restrict first, const uint32_t *restrict second,
                               const float *restrict stiffness, const float *restrict tension,
                               const float *restrict damping, const float *restrict state, float *restrict pull,
                               int is_damped, int by_newton) {
    for (long s = 0; s < n; s += 16) {
        __m512 square, dot = _mm512_setzero_ps(), part[8];
        if (is_damped) {
#pragma GCC unroll 8
            for (int l = 0; l < 8; l++) {
                const long at = s + (l & 3) + 8 * (l >> 2);
                const __m512 d = rows_float(state, first, second, at, at + 4);
                part[l] = _mm512_mul_ps(d, _mm512_shuffle_f32x4(d, d, 0xA0));
            }
            const __m512 low = lane_sums(part[0], part[1], part[2], part[3]);
            const __m512 high = lane_sums(part[4], part[5], part[6], part[7]);
            square = _mm512_shuffle_f32x4(low, high, 0x88);
            dot = _mm512_shuffle_f32x4(low, high, 0xDD);
        } else {
#pragma GCC unroll 4
            for (int l = 0; l < 4; l++) {
                const __m512 d = positions_float(state, first, second, s + l);
                part[l] = _mm512_mul_ps(d, d);
            }
            square = lane_sums(part[0], part[1], part[2], part[3]);
        }
        const __m512 inverse = inverse_root_float(square, by_newton);
        __m512 sum = _mm512_fnmadd_ps(_mm512_load_ps(tension + s), inverse, _mm512_load_ps(stiffness + s));
        if (is_damped)
            sum = _mm512_fmadd_ps(_mm512_mul_ps(_mm512_load_ps(damping + s), dot), _mm512_mul_ps(inverse, inverse), sum);
        _mm512_store_ps(pull + s, sum);
    }
}

ALWAYS void scatter_double(long n, const uint32_t *restrict first, const uint32_t *restrict second,
                           const double *restrict pull, const double *restrict state, double *restrict force) {
#pragma GCC unroll 8
    for (long s = 0; s < n; s++) {
        const long i = first[s], j = second[s];
        const __m256d d = _mm256_sub_pd(_mm256_load_pd(state + 8 * j), _mm256_load_pd(state + 8 * i));
        const __m256d f = _mm256_mul_pd(_mm256_broadcast_sd(pull + s), d);
        _mm256_store_pd(force + 4 * i, _mm256_add_pd(_mm256_load_pd(force + 4 * i), f));
        _mm256_store_pd(force + 4 * j, _mm256_sub_pd(_mm256_load_pd(force + 4 * j), f));
    }
}

ALWAYS void scatter_float(long n, const uint32_t *restrict first, const uint32_t *restrict second,
                          const float *restrict pull, const float *restrict state, float *restrict force) {
#pragma GCC unroll 8
    for (long s = 0; s < n; s++) {
        const long i = first[s], j = second[s];
        const __m128 d = _mm_sub_ps(_mm_load_ps(state + 8 * j), _mm_load_ps(state + 8 * i));
        const __m128 f = _mm_mul_ps(_mm_broadcast_ss(pull + s), d);
        _mm_store_ps(force + 4 * i, _mm_add_ps(_mm_load_ps(force + 4 * i), f));
        _mm_store_ps(force + 4 * j, _mm_sub_ps(_mm_load_ps(force + 4 * j), f));
    }
}

ALWAYS void stage_double(int stage, long n, double reach, double weight, const double *restrict inverse_mass,
                         const double *restrict gravity, double drag, double *restrict state, double *restrict there,
                         double *restrict total, double *restrict force) {
    const __m512d far = _mm512_set1_pd(reach), share = _mm512_set1_pd(weight);
    for (long i = 0; i < n; i++) {
        const __m256d speed = _mm256_load_pd((stage ? there : state) + 8 * i + 4);
        const __m256d field = _mm256_fnmadd_pd(_mm256_set1_pd(drag), speed, _mm256_load_pd(gravity + 4 * i));
        const __m256d gain = _mm256_fmadd_pd(_mm256_broadcast_sd(inverse_mass + i), _mm256_load_pd(force + 4 * i), field);
        const __m512d slope = _mm512_insertf64x4(_mm512_castpd256_pd512(speed), gain, 1);
        _mm256_store_pd(force + 4 * i, _mm256_setzero_pd());
        if (stage == 3) {
            _mm512_store_pd(state + 8 * i, _mm512_fmadd_pd(share, slope, _mm512_load_pd(total + 8 * i)));
        } else {
            const __m512d start = _mm512_load_pd(state + 8 * i), before = stage ? _mm512_load_pd(total + 8 * i) : start;
            _mm512_store_pd(total + 8 * i, _mm512_fmadd_pd(share, slope, before));
            _mm512_store_pd(there + 8 * i, _mm512_fmadd_pd(far, slope, start));
        }
    }
}

ALWAYS void stage_float(int stage, long n, float reach, float weight, const float *restrict inverse_mass,
                        const float *restrict gravity, float drag, float *restrict state, float *restrict there,
                        float *restrict total, float *restrict force) {
    const __m256 far = _mm256_set1_ps(reach), share = _mm256_set1_ps(weight);
    for (long i = 0; i < n; i++) {
        const __m128 speed = _mm_load_ps((stage ? there : state) + 8 * i + 4);
        const __m128 field = _mm_fnmadd_ps(_mm_set1_ps(drag), speed, _mm_load_ps(gravity + 4 * i));
        const __m128 gain = _mm_fmadd_ps(_mm_broadcast_ss(inverse_mass + i), _mm_load_ps(force + 4 * i), field);
        const __m256 slope = _mm256_insertf128_ps(_mm256_castps128_ps256(speed), gain, 1);
        _mm_store_ps(force + 4 * i, _mm_setzero_ps());
        if (stage == 3) {
            _mm256_store_ps(state + 8 * i, _mm256_fmadd_ps(share, slope, _mm256_load_ps(total + 8 * i)));
        } else {
            const __m256 start = _mm256_load_ps(state + 8 * i), before = stage ? _mm256_load_ps(total + 8 * i) : start;
            _mm256_store_ps(total + 8 * i, _mm256_fmadd_ps(share, slope, before));
            _mm256_store_ps(there + 8 * i, _mm256_fmadd_ps(far, slope, start));
        }
    }
}

#define VECTOR(REAL)                                                                                                         \
    ALWAYS void vector_##REAL##_steps(long n_steps, REAL step, long n_nodes, long n_springs, const uint32_t *first,          \
                                      const uint32_t *second, const REAL *stiffness, const REAL *tension,                    \
                                      const REAL *damping, const REAL *inverse_mass, const REAL *gravity, REAL drag,         \
                                      REAL *state, REAL *there, REAL *total, REAL *force, REAL *pull, int is_damped,         \
                                      int by_newton) {                                                                       \
        const REAL reach[4] = {step / 2, step / 2, step, 0}, weight[4] = {step / 6, step / 3, step / 3, step / 6};           \
        for (long t = 0; t < n_steps; t++) {                                                                                 \
            _Pragma("GCC unroll 4") for (int stage = 0; stage < 4; stage++) {                                                \
                const REAL *at = stage ? there : state;                                                                      \
                coefficients_##REAL(n_springs, first, second, stiffness, tension, damping, at, pull, is_damped, by_newton);  \
                scatter_##REAL(n_springs, first, second, pull, at, force);                                                   \
                stage_##REAL(stage, n_nodes, reach[stage], weight[stage], inverse_mass, gravity, drag, state, there, total,  \
                             force);                                                                                         \
            }                                                                                                                \
        }                                                                                                                    \
    }                                                                                                                        \
    void vector_##REAL(long n_steps, REAL step, long n_nodes, long n_springs, const uint32_t *first,                         \
                       const uint32_t *second, const REAL *stiffness, const REAL *tension, const REAL *damping,              \
                       const REAL *inverse_mass, const REAL *gravity, REAL drag, REAL *state, REAL *there, REAL *total,      \
                       REAL *force, REAL *pull, int is_damped, int by_newton) {                                              \
        if (is_damped && by_newton)                                                                                          \
            vector_##REAL##_steps(n_steps, step, n_nodes, n_springs, first, second, stiffness, tension, damping,             \
                                  inverse_mass, gravity, drag, state, there, total, force, pull, 1, 1);                      \
        else if (is_damped)                                                                                                  \
            vector_##REAL##_steps(n_steps, step, n_nodes, n_springs, first, second, stiffness, tension, damping,             \
                                  inverse_mass, gravity, drag, state, there, total, force, pull, 1, 0);                      \
        else if (by_newton)                                                                                                  \
            vector_##REAL##_steps(n_steps, step, n_nodes, n_springs, first, second, stiffness, tension, damping,             \
                                  inverse_mass, gravity, drag, state, there, total, force, pull, 0, 1);                      \
        else                                                                                                                 \
            vector_##REAL##_steps(n_steps, step, n_nodes, n_springs, first, second, stiffness, tension, damping,             \
                                  inverse_mass, gravity, drag, state, there, total, force, pull, 0, 0);                      \
    }

VECTOR(double)
VECTOR(float)
#endif

// ----------------------------------------------------------------------------------------------------------------- peak

// Multiply and add in 12 vectors that do not wait for each other: 12 * 8 * 2 operations a round, nothing read or written.
typedef double pack __attribute__((vector_size(64)));

double peak_double(long n_rounds) {
    pack sum[12], factor, term;
    double result = 0;
    for (int lane = 0; lane < 8; lane++) factor[lane] = 0.999, term[lane] = 1e-3;
    for (int l = 0; l < 12; l++) sum[l] = term * l;
    for (long round = 0; round < n_rounds; round++) {
#pragma GCC unroll 12
        for (int l = 0; l < 12; l++) sum[l] = sum[l] * factor + term;
    }
    for (int l = 0; l < 12; l++) result += sum[l][l & 7];
    return result;
}
