/* What a compiled program needs from the mosaic to XYZ: the floor that benchmarks/tail.py compares with.

   One frame, float32: one normal per pixel (counter-based, the variance of shot and read noise together), clip, code,
   linear value, colour-difference demosaic (RGGB, borders repeated), Laplacian sharpening, one 3 x 3 matrix (all linear
   colour steps at once), clip, v^0.45, one more 3 x 3 matrix. Nothing is stored between, nothing is checked, and
   logarithm, exponential and cosine are polynomials of about 1e-4: less than the product does, which is what makes it a floor.

   cc -O3 -march=native -ffast-math -shared -fPIC tail_floor.c -o tail_floor.so
*/
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

static inline float log2_fast(float v) {
    union { float f; uint32_t i; } u = { v };
    float e = (float)((int32_t)(u.i >> 23) - 127);
    u.i = (u.i & 0x007fffffu) | 0x3f800000u;
    float m = u.f;
    return e + (-2.7868f + m * (4.0530f + m * (-1.7118f + m * (0.5146f - 0.0691f * m))));
}

static inline float exp2_fast(float v) {
    v = v < -120.f ? -120.f : v;
    float whole = (float)(int32_t)(v + 128.f) - 128.f, part = v - whole;
    union { uint32_t i; float f; } u = { (uint32_t)((int32_t)whole + 127) << 23 };
    return u.f * (1.f + part * (0.69315f + part * (0.24023f + part * (0.05550f + part * 0.00962f))));
}

static inline uint32_t mix(uint32_t x) {
    x ^= x >> 16; x *= 0x7feb352du; x ^= x >> 15; x *= 0x846ca68bu; x ^= x >> 16;
    return x;
}

static inline float normal(uint32_t counter, uint32_t seed) {  /* Box-Muller on two hashes */
    uint32_t a = mix(counter * 2u + seed), b = mix(counter * 2u + 1u + seed * 3u);
    float u = ((float)(a >> 9) + 0.5f) * (1.f / 8388608.f);
    float t = (float)(b >> 9) * (1.f / 8388608.f) - 0.5f;          /* cos(2 pi t), t in -1/2 .. 1/2 */
    float q = t * t, c = 1.f + q * (-19.739209f + q * (64.939394f + q * (-85.456817f + q * (60.24464f - 26.4f * q))));
    float r2 = -1.3862944f * log2_fast(u);
    return __builtin_sqrtf(r2) * c;
}

void tail(const float *restrict mean, int rows, int columns, uint32_t seed, float read_variance, float well, float gain, float black,
          float top, float strength, const float *restrict first, const float *restrict second, float *restrict rgb_out,
          float *restrict xyz_out) {
    int wide = columns + 4, size = (rows + 4) * wide;
    float *raw = malloc(4 * sizeof(float) * size + 4 * sizeof(float) * size), *green = raw + size, *red = green + size, *blue = red + size;
    float scale = 1.f / (top - black);
    for (int y = 0; y < rows; y++) {
        float *row = raw + (y + 2) * wide + 2;
        for (int x = 0; x < columns; x++) {
            float m = mean[y * columns + x];
            float charge = m + __builtin_sqrtf(m + read_variance) * normal((uint32_t)(y * columns + x), seed);
            charge = charge > well ? well : charge;
            float code = (float)(int32_t)(charge * gain + black + 0.5f);
            code = code < 0.f ? 0.f : code > top ? top : code;
            row[x] = (code - black) * scale;
        }
        row[-1] = row[1]; row[-2] = row[2]; row[columns] = row[columns - 2]; row[columns + 1] = row[columns - 3];
    }
    memcpy(raw + wide, raw + 3 * wide, 4 * wide); memcpy(raw, raw + 4 * wide, 4 * wide);
    memcpy(raw + (rows + 2) * wide, raw + rows * wide, 4 * wide); memcpy(raw + (rows + 3) * wide, raw + (rows - 1) * wide, 4 * wide);
    for (int y = 1; y < rows + 3; y++)
        for (int x = 1; x < wide - 1; x++) {
            const float *p = raw + y * wide + x;
            float around = 0.25f * (p[-1] + p[1] + p[-wide] + p[wide]);
            green[y * wide + x] = ((x ^ y) & 1) ? *p : around;
        }
    for (int y = 2; y < rows + 2; y++)
        for (int x = 2; x < columns + 2; x++) {
            const float *p = raw + y * wide + x, *g = green + y * wide + x;
            float own = p[0] - g[0];
            float across = 0.5f * (p[-1] - g[-1] + p[1] - g[1]), along = 0.5f * (p[-wide] - g[-wide] + p[wide] - g[wide]);
            float corner = 0.25f * (p[-wide - 1] - g[-wide - 1] + p[-wide + 1] - g[-wide + 1] + p[wide - 1] - g[wide - 1] + p[wide + 1] - g[wide + 1]);
            int even_row = !(y & 1), even_column = !(x & 1);
            float kr = even_row ? (even_column ? own : across) : (even_column ? along : corner);
            float kb = even_row ? (even_column ? corner : along) : (even_column ? across : own);
            red[y * wide + x] = g[0] + kr;
            blue[y * wide + x] = g[0] + kb;
        }
    for (int y = 0; y < rows; y++) {
        int up = y ? -wide : 0, down = y < rows - 1 ? wide : 0;
        for (int x = 0; x < columns; x++) {
            int at = (y + 2) * wide + x + 2, left = x ? -1 : 0, right = x < columns - 1 ? 1 : 0;
            float v[3];
            const float *planes[3] = { red, green, blue };
            for (int c = 0; c < 3; c++) {
                const float *p = planes[c] + at;
                float box = p[up + left] + p[up] + p[up + right] + p[left] + p[0] + p[right] + p[down + left] + p[down] + p[down + right];
                v[c] = p[0] + strength * (9.f * p[0] - box);
            }
            float e[3];
            for (int c = 0; c < 3; c++) {
                float linear = first[3 * c] * v[0] + first[3 * c + 1] * v[1] + first[3 * c + 2] * v[2];
                linear = linear < 1e-6f ? 1e-6f : linear > 1.f ? 1.f : linear;
                e[c] = linear;
                rgb_out[c * rows * columns + y * columns + x] = exp2_fast(0.45f * log2_fast(linear));
            }
            for (int c = 0; c < 3; c++)
                xyz_out[c * rows * columns + y * columns + x] = second[3 * c] * e[0] + second[3 * c + 1] * e[1] + second[3 * c + 2] * e[2];
        }
    }
    free(raw);
}
