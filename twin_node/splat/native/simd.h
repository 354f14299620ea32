// One vector of floats at the width of the target, with the few operations that the kernels need.
//
// GCC lowers a vector wider than the target's registers badly, so the width follows the instruction set: 16 lanes with
// AVX-512, 8 with AVX2, 4 with SSE2, NEON and anything else.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace splat {

#if defined(__AVX512F__)
constexpr int kLanes = 16;
#elif defined(__AVX2__)
constexpr int kLanes = 8;
#else
constexpr int kLanes = 4;
#endif

typedef float Vec __attribute__((vector_size(kLanes * 4)));
typedef int32_t IntVec __attribute__((vector_size(kLanes * 4)));

inline Vec broadcast(float x) { return x - Vec{}; }  // not a sum: -0 + 0 is another number, which has to be computed
inline IntVec broadcast(int32_t x) { return x - IntVec{}; }

inline Vec load(const float *from) {
  Vec out;
  std::memcpy(&out, from, sizeof(out));
  return out;
}
inline void store(float *to, Vec x) { std::memcpy(to, &x, sizeof(x)); }

#if defined(__AVX512F__)

typedef __mmask16 Mask;
inline Mask ge(Vec a, Vec b) { return _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_GE_OQ); }
inline Mask gt(Vec a, Vec b) { return _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_GT_OQ); }
inline Mask le(Vec a, Vec b) { return _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_LE_OQ); }
inline Mask both(Mask a, Mask b) { return a & b; }
inline Mask first_only(Mask a, Mask b) { return a & static_cast<Mask>(~b); }
inline uint32_t bits(Mask m) { return m; }
inline Vec select(Mask m, Vec yes, Vec no) { return (Vec)_mm512_mask_blend_ps(m, (__m512)no, (__m512)yes); }
inline Vec min(Vec a, Vec b) { return (Vec)_mm512_min_ps((__m512)a, (__m512)b); }
inline Vec max(Vec a, Vec b) { return (Vec)_mm512_max_ps((__m512)a, (__m512)b); }
inline Vec sqrt(Vec a) { return (Vec)_mm512_sqrt_ps((__m512)a); }
inline Vec gather(const float *base, IntVec index) { return (Vec)_mm512_i32gather_ps((__m512i)index, base, 4); }
// 1 / a to about one unit in the last place: the 14-bit estimate and one Newton step.
inline Vec reciprocal(Vec a) {
  Vec r = (Vec)_mm512_rcp14_ps((__m512)a);
  return r * (2.0f - a * r);
}

#else

typedef IntVec Mask;
inline Mask ge(Vec a, Vec b) { return a >= b; }
inline Mask gt(Vec a, Vec b) { return a > b; }
inline Mask le(Vec a, Vec b) { return a <= b; }
inline Mask both(Mask a, Mask b) { return a & b; }
inline Mask first_only(Mask a, Mask b) { return a & ~b; }
inline Vec select(Mask m, Vec yes, Vec no) { return m ? yes : no; }
inline Vec reciprocal(Vec a) { return 1.0f / a; }

#if defined(__AVX2__)
inline uint32_t bits(Mask m) { return static_cast<uint32_t>(_mm256_movemask_ps((__m256)m)); }
inline Vec min(Vec a, Vec b) { return (Vec)_mm256_min_ps((__m256)a, (__m256)b); }
inline Vec max(Vec a, Vec b) { return (Vec)_mm256_max_ps((__m256)a, (__m256)b); }
inline Vec sqrt(Vec a) { return (Vec)_mm256_sqrt_ps((__m256)a); }
inline Vec gather(const float *base, IntVec index) { return (Vec)_mm256_i32gather_ps(base, (__m256i)index, 4); }
#else
#if defined(__SSE2__)
inline uint32_t bits(Mask m) { return static_cast<uint32_t>(_mm_movemask_ps((__m128)m)); }
inline Vec min(Vec a, Vec b) { return (Vec)_mm_min_ps((__m128)a, (__m128)b); }
inline Vec max(Vec a, Vec b) { return (Vec)_mm_max_ps((__m128)a, (__m128)b); }
inline Vec sqrt(Vec a) { return (Vec)_mm_sqrt_ps((__m128)a); }
#else
inline uint32_t bits(Mask m) { return (m[0] & 1u) | (m[1] & 2u) | (m[2] & 4u) | (m[3] & 8u); }
inline Vec min(Vec a, Vec b) { return a < b ? a : b; }
inline Vec max(Vec a, Vec b) { return a > b ? a : b; }
inline Vec sqrt(Vec a) {
  Vec out;
  for (int lane = 0; lane < kLanes; lane++) out[lane] = __builtin_sqrtf(a[lane]);
  return out;
}
#endif
inline Vec gather(const float *base, IntVec index) {
  Vec out;
  for (int lane = 0; lane < kLanes; lane++) out[lane] = base[index[lane]];
  return out;
}
#endif
#endif

inline bool any(Mask m) { return bits(m) != 0; }

inline Vec abs(Vec a) { return (Vec)((IntVec)a & broadcast(int32_t{0x7fffffff})); }

inline float sum(Vec a) {
#if defined(__AVX512F__)
  return _mm512_reduce_add_ps((__m512)a);
#else
  float total = 0.f;
  for (int lane = 0; lane < kLanes; lane++) total += a[lane];
  return total;
#endif
}

// 0, 1, 2, ... in the lanes.
inline IntVec lane_numbers() {
  IntVec out;
  for (int lane = 0; lane < kLanes; lane++) out[lane] = lane;
  return out;
}

// 2^e for e <= 0 (below 2^-30 it stays there): degree-5 polynomial on [-0.5, 0.5], relative error 2.3e-7.
inline Vec exp2_nonpositive(Vec e) {
  e = max(e, broadcast(-30.f));
  const IntVec whole = __builtin_convertvector(e - 0.5f, IntVec);  // truncation rounds to nearest, as e <= 0
  const Vec part = e - __builtin_convertvector(whole, Vec);
  Vec p = broadcast(1.327647203e-03f);
  p = p * part + 9.675541480e-03f;
  p = p * part + 5.550713275e-02f;
  p = p * part + 2.402211972e-01f;
  p = p * part + 6.931469671e-01f;
  p = p * part + 1.000000072e+00f;
  return (Vec)((IntVec)p + (whole << 23));
}

// log2 of positive normal numbers: atanh series on the mantissa in [sqrt(1/2), sqrt(2)), relative error 1e-7.
inline Vec log2_positive(Vec x) {
  const IntVec word = (IntVec)x;
  const IntVec shifted = word - 0x3f3504f3;  // the bits of sqrt(1/2)
  const IntVec exponent = shifted >> 23;
  const Vec mantissa = (Vec)(word - (exponent << 23));
  const Vec s = (mantissa - 1.0f) / (mantissa + 1.0f), s2 = s * s;
  constexpr float kTwoOverLn2 = 2.8853900817779268f;
  Vec series = broadcast(kTwoOverLn2 / 9);
  series = series * s2 + kTwoOverLn2 / 7;
  series = series * s2 + kTwoOverLn2 / 5;
  series = series * s2 + kTwoOverLn2 / 3;
  series = series * s2 + kTwoOverLn2;
  return __builtin_convertvector(exponent, Vec) + s * series;
}

// Sums over the lanes of four vectors at once, to[0..3]: a transposed reduction, a third of the work of four single
// sums.
inline void sum4(Vec a, Vec b, Vec c, Vec d, float *to) {
#if defined(__AVX512F__)
  const __m512 ab = _mm512_add_ps(_mm512_unpacklo_ps((__m512)a, (__m512)b), _mm512_unpackhi_ps((__m512)a, (__m512)b));
  const __m512 cd = _mm512_add_ps(_mm512_unpacklo_ps((__m512)c, (__m512)d), _mm512_unpackhi_ps((__m512)c, (__m512)d));
  const __m512 low = _mm512_shuffle_ps(ab, cd, 0x44), high = _mm512_shuffle_ps(ab, cd, 0xee);
  const __m512 quads = _mm512_add_ps(low, high);
  const __m256 half = _mm256_add_ps(_mm512_castps512_ps256(quads), _mm512_extractf32x8_ps(quads, 1));
  _mm_storeu_ps(to, _mm_add_ps(_mm256_castps256_ps128(half), _mm256_extractf128_ps(half, 1)));
#elif defined(__AVX2__)
  const __m256 ab = _mm256_add_ps(_mm256_unpacklo_ps((__m256)a, (__m256)b), _mm256_unpackhi_ps((__m256)a, (__m256)b));
  const __m256 cd = _mm256_add_ps(_mm256_unpacklo_ps((__m256)c, (__m256)d), _mm256_unpackhi_ps((__m256)c, (__m256)d));
  const __m256 quads = _mm256_add_ps(_mm256_shuffle_ps(ab, cd, 0x44), _mm256_shuffle_ps(ab, cd, 0xee));
  _mm_storeu_ps(to, _mm_add_ps(_mm256_castps256_ps128(quads), _mm256_extractf128_ps(quads, 1)));
#elif defined(__SSE2__)
  const __m128 ab = _mm_add_ps(_mm_unpacklo_ps((__m128)a, (__m128)b), _mm_unpackhi_ps((__m128)a, (__m128)b));
  const __m128 cd = _mm_add_ps(_mm_unpacklo_ps((__m128)c, (__m128)d), _mm_unpackhi_ps((__m128)c, (__m128)d));
  _mm_storeu_ps(to, _mm_add_ps(_mm_shuffle_ps(ab, cd, 0x44), _mm_shuffle_ps(ab, cd, 0xee)));
#else
  to[0] = sum(a);
  to[1] = sum(b);
  to[2] = sum(c);
  to[3] = sum(d);
#endif
}

// Every group of four lanes from four floats in a row, `stride` floats from group to group.
inline Vec load_fours(const float *from, int64_t stride) {
#if defined(__AVX512F__)
  __m512 out = _mm512_castps128_ps512(_mm_loadu_ps(from));
  out = _mm512_insertf32x4(out, _mm_loadu_ps(from + stride), 1);
  out = _mm512_insertf32x4(out, _mm_loadu_ps(from + 2 * stride), 2);
  return (Vec)_mm512_insertf32x4(out, _mm_loadu_ps(from + 3 * stride), 3);
#elif defined(__AVX2__)
  return (Vec)_mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(from)), _mm_loadu_ps(from + stride), 1);
#else
  static_cast<void>(stride);  // there is one group
  return load(from);
#endif
}

inline void store_fours(float *to, int64_t stride, Vec x) {
#if defined(__AVX512F__)
  _mm_storeu_ps(to, _mm512_castps512_ps128((__m512)x));
  _mm_storeu_ps(to + stride, _mm512_extractf32x4_ps((__m512)x, 1));
  _mm_storeu_ps(to + 2 * stride, _mm512_extractf32x4_ps((__m512)x, 2));
  _mm_storeu_ps(to + 3 * stride, _mm512_extractf32x4_ps((__m512)x, 3));
#elif defined(__AVX2__)
  _mm_storeu_ps(to, _mm256_castps256_ps128((__m256)x));
  _mm_storeu_ps(to + stride, _mm256_extractf128_ps((__m256)x, 1));
#else
  static_cast<void>(stride);
  store(to, x);
#endif
}

// Turns every group of four lanes of four vectors: lane i of v[j] and lane j of v[i] change places.
inline void transpose4(Vec *v) {
#if defined(__AVX512F__)
  const __m512 a = (__m512)v[0], b = (__m512)v[1], c = (__m512)v[2], d = (__m512)v[3];
  const __m512 ab_low = _mm512_unpacklo_ps(a, b), ab_high = _mm512_unpackhi_ps(a, b);
  const __m512 cd_low = _mm512_unpacklo_ps(c, d), cd_high = _mm512_unpackhi_ps(c, d);
  v[0] = (Vec)_mm512_shuffle_ps(ab_low, cd_low, 0x44);
  v[1] = (Vec)_mm512_shuffle_ps(ab_low, cd_low, 0xee);
  v[2] = (Vec)_mm512_shuffle_ps(ab_high, cd_high, 0x44);
  v[3] = (Vec)_mm512_shuffle_ps(ab_high, cd_high, 0xee);
#elif defined(__AVX2__)
  const __m256 a = (__m256)v[0], b = (__m256)v[1], c = (__m256)v[2], d = (__m256)v[3];
  const __m256 ab_low = _mm256_unpacklo_ps(a, b), ab_high = _mm256_unpackhi_ps(a, b);
  const __m256 cd_low = _mm256_unpacklo_ps(c, d), cd_high = _mm256_unpackhi_ps(c, d);
  v[0] = (Vec)_mm256_shuffle_ps(ab_low, cd_low, 0x44);
  v[1] = (Vec)_mm256_shuffle_ps(ab_low, cd_low, 0xee);
  v[2] = (Vec)_mm256_shuffle_ps(ab_high, cd_high, 0x44);
  v[3] = (Vec)_mm256_shuffle_ps(ab_high, cd_high, 0xee);
#elif defined(__SSE2__)
  __m128 a = (__m128)v[0], b = (__m128)v[1], c = (__m128)v[2], d = (__m128)v[3];
  _MM_TRANSPOSE4_PS(a, b, c, d);
  v[0] = (Vec)a;
  v[1] = (Vec)b;
  v[2] = (Vec)c;
  v[3] = (Vec)d;
#else
  for (int i = 0; i < 4; i++) {
    for (int j = 0; j < i; j++) {
      for (int group = 0; group < kLanes; group += 4) {
        const float swapped = v[i][group + j];
        v[i][group + j] = v[j][group + i];
        v[j][group + i] = swapped;
      }
    }
  }
#endif
}

// Four floats of each of as many things as there are lanes, one vector per float: of every four things in a row, the
// first at `from`, `stride` floats from four to four.
inline void load_quads(const float *from, int64_t stride, Vec *to) {
  for (int i = 0; i < 4; i++) to[i] = load_fours(from + 4 * i, stride);
  transpose4(to);
}

inline void store_quads(float *to, int64_t stride, const Vec *from) {
  Vec things[4] = {from[0], from[1], from[2], from[3]};
  transpose4(things);
  for (int i = 0; i < 4; i++) store_fours(to + 4 * i, stride, things[i]);
}

// 1 in the lanes whose byte is not 0, else 0.
inline IntVec ones_where(const uint8_t *bytes) {
  typedef uint8_t ByteVec __attribute__((vector_size(kLanes)));
  ByteVec given;
  std::memcpy(&given, bytes, sizeof(given));
  return __builtin_convertvector(given, IntVec) != 0 ? broadcast(int32_t{1}) : IntVec{};
}

}  // namespace splat
