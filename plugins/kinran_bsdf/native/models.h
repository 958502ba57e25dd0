// The classes of kinran_bsdf/models, as formulas with the same names; a test holds the two together for each model.
#pragma once

#include <mitsuba/core/vector.h>
#include <mitsuba/core/warp.h>

#include <array>
#include <string>
#include <utility>
#include <vector>

namespace kinran {

enum class Model { Takeda2008, Slope, Lambert };

constexpr float WidthFloor = 1e-3f;

/// What a model is called, how many lobes it can have, whether shapes may be averaged between texels, and the parameters
/// of a lobe with the values that they have where nobody gives any
struct ModelInfo {
    Model model;
    std::string name;
    int least, most;
    bool filtered;
    std::vector<std::pair<std::string, float>> parameters;
};

inline const std::vector<ModelInfo> ModelTable = {
    { Model::Takeda2008, "takeda2008", 1, 1, false, { { "theta", 0.f }, { "phi", 0.f }, { "dt", .2f }, { "dp", .5f } } },
    { Model::Slope, "slope", 1, 2, true, { { "x", 0.f }, { "y", 0.f }, { "xx", .04f }, { "xy", 0.f }, { "yy", .04f } } },
    { Model::Lambert, "lambert", 0, 0, true, {} },
};

inline const std::vector<std::pair<std::string, float>> DiffuseParameters = { { "x", 0.f }, { "y", 0.f } };
inline const std::vector<std::string> Tails = { "gaussian", "ggx" };

}  // namespace kinran

NAMESPACE_BEGIN(mitsuba)

using kinran::Model;

template <typename Float_> struct Models {
    using Float    = Float_;
    using Point2f  = Point<Float, 2>;
    using Vector3f = Vector<Float, 3>;
    using Mask     = dr::mask_t<Float>;
    using Shape    = std::array<Float, 5>;  // slope: x, y, xx, xy, yy; takeda2008: theta, phi, dt, dp
    using Scalar   = dr::scalar_t<Float>;

    static constexpr Scalar Pi         = dr::Pi<Scalar>;
    static constexpr int NewtonSteps   = 8;  // with 4 wide lobes come out biased
    static constexpr Scalar AlmostOne  = (Scalar) 0.9999999;

    Model model;
    bool ggx;
    Float floor;  // cosine from which T fades to the horizon

    static Float release(const Vector3f &v, const Vector3f &l) {
        return dr::square(dr::square(dr::square(dr::maximum(v.z(), l.z()))));
    }

    Float diffuse_lift(const Vector3f &v, const Vector3f &l, const Shape &p) const {
        Float cap = 2 / dr::maximum(1 - release(v, l), (Scalar) 1e-4);
        auto area = [&](const Vector3f &w) {
            return dr::minimum(dr::maximum(1 + (p[0] * w.x() + p[1] * w.y()) / dr::maximum(w.z(), floor), 0), cap);
        };
        return area(v) * area(l) * l.z();
    }

    static Float diffuse_albedo(const Shape &p) {
        return (Scalar) 0.5 * Pi * (1 + dr::sqrt(1 + p[0] * p[0] + p[1] * p[1]));
    }

    Float lobe(const Vector3f &v, const Vector3f &l, const Shape &p) const {
        if (model == Model::Takeda2008)
            return takeda_lobe(v + l, p);
        Float z = v.z() + l.z();
        return slope_lobe((v.x() + l.x()) / z, (v.y() + l.y()) / z, p) * lobe_lift(v, l);
    }

    Float slope_lobe(const Float &x, const Float &y, const Shape &p) const {
        Float dx = x - p[0], dy = y - p[1];
        Float q = (p[4] * dx * dx - 2 * p[3] * dx * dy + p[2] * dy * dy) / (p[2] * p[4] - p[3] * p[3]);
        return ggx ? dr::square(dr::rcp(1 + q)) : dr::exp(-q);
    }

    static Float takeda_lobe(const Vector3f &h, const Shape &p) {
        Float theta = dr::atan2(dr::sqrt(h.x() * h.x() + h.y() * h.y()), h.z());
        Float turn  = dr::atan2(h.y(), h.x()) - p[1];
        turn -= 2 * Pi * dr::round(turn / (2 * Pi));
        return dr::exp(-dr::square((theta - p[0]) / p[2]) - dr::square(turn / p[3]));
    }

    Float lobe_lift(const Vector3f &v, const Vector3f &l) const {
        Float x = v.x() + l.x(), y = v.y() + l.y(), z = v.z() + l.z();
        Float tilt = 2 * z / (x * x + y * y + z * z);
        Float masking = dr::minimum(1, tilt * dr::maximum(release(v, l), dr::minimum(v.z(), l.z())));
        return masking * l.z() / (dr::maximum(v.z(), floor) * dr::maximum(l.z(), floor));
    }

    /// Albedo at V = N of a lobe of amplitude 1, nearly
    Float albedo(const Shape &p) const {
        if (model == Model::Takeda2008) {
            Float sine = dr::maximum(dr::sin(p[0]), (Scalar) 0.5 * p[2]);
            return 4 * Pi * p[2] * dr::minimum(p[3], 2 * dr::sqrt(Pi)) * sine *
                   dr::maximum(dr::cos(p[0]), (Scalar) 0.05);
        }
        Float z = dr::rcp(1 + p[0] * p[0] + p[1] * p[1] + (Scalar) 0.5 * (p[2] + p[4]));
        return 4 * Pi * dr::sqrt(dr::maximum(p[2] * p[4] - p[3] * p[3], 0)) * z * z;
    }

    /// Shape of a lobe that can be rendered, whatever textures say
    Shape confined(Shape p) const {
        if (model == Model::Takeda2008) {
            p[2] = dr::maximum(p[2], kinran::WidthFloor);
            p[3] = dr::maximum(p[3], kinran::WidthFloor);
            return p;
        }
        p[2] = dr::maximum(p[2], kinran::WidthFloor * kinran::WidthFloor);
        p[4] = dr::maximum(p[4], kinran::WidthFloor * kinran::WidthFloor);
        Float most = (Scalar) 0.999 * dr::sqrt(p[2] * p[4]);
        p[3] = dr::clip(p[3], -most, most);
        return p;
    }

    Vector3f sample(const Shape &p, const Point2f &u) const {
        return model == Model::Takeda2008 ? sample_takeda(p, u) : sample_slope(p, u);
    }

    Vector3f sample_slope(const Shape &p, const Point2f &u) const {
        Float rest = dr::maximum(1 - u.x(), (Scalar) 1e-7);
        Float r = dr::sqrt(ggx ? (1 - rest) / rest : -dr::log(rest));
        auto [s, c] = dr::sincos(2 * Pi * u.y());
        Float a = dr::sqrt(p[2]), b = p[3] / a, d = dr::sqrt(dr::maximum(p[4] - b * b, 0));
        return dr::normalize(Vector3f(p[0] + a * r * c, p[1] + b * r * c + d * r * s, 1));
    }

    /// Density in solid angle of the light that a sampled half vector leads to
    Float density(const Shape &p, const Vector3f &v, const Vector3f &l) const {
        Vector3f sum = v + l;
        Float square = dr::squared_norm(sum);
        if (model == Model::Takeda2008)
            return density_takeda(p, sum) / dr::maximum(2 * dr::sqrt(square), (Scalar) 1e-6);
        Float z = sum.z();
        return slope_lobe(sum.x() / z, sum.y() / z, p) * square /
               (2 * Pi * dr::sqrt(p[2] * p[4] - p[3] * p[3]) * z * z * z);
    }

    // Eq. 3 in θ: density ∝ θ exp(−((θ − m) / s)²) on [0, π/2], and its antiderivative

    static Float primitive(const Float &x, const Float &m, const Float &s) {
        return (Scalar) 0.5 * dr::sqrt(Pi) * m * dr::erf(x) - (Scalar) 0.5 * s * dr::exp(-x * x);
    }

    static Float density_takeda(const Shape &p, const Vector3f &h) {
        Float theta = dr::atan2(dr::sqrt(h.x() * h.x() + h.y() * h.y()), h.z());
        Float start = primitive(-p[0] / p[2], p[0], p[2]),
              end = primitive(((Scalar) 0.5 * Pi - p[0]) / p[2], p[0], p[2]);
        Float norm = p[2] * (end - start) * p[3] * dr::sqrt(Pi) * dr::erf(Pi / p[3]);
        Float ratio = dr::select(theta > (Scalar) 1e-4, theta / dr::maximum(dr::sin(theta), (Scalar) 1e-5), 1);
        return dr::select(norm > 0, takeda_lobe(h, p) * ratio / dr::maximum(norm, (Scalar) 1e-30), 0);
    }

    static Vector3f sample_takeda(const Shape &p, const Point2f &u) {
        const Float &theta = p[0], &phi = p[1], &dt = p[2], &dp = p[3];
        Float low = -theta / dt, high = ((Scalar) 0.5 * Pi - theta) / dt;
        Float target = dr::lerp(primitive(low, theta, dt), primitive(high, theta, dt), u.x());
        low = dr::maximum(low, -5);
        high = dr::minimum(high, 5);
        Float x = dr::erfinv(dr::clip(dr::lerp(dr::erf(low), dr::erf(high), u.x()), -AlmostOne, AlmostOne));
        x = dr::clip(x, low, high);
        for (int k = 0; k < NewtonSteps; ++k) {
            Float error = primitive(x, theta, dt) - target;
            low = dr::select(error < 0, x, low);
            high = dr::select(error < 0, high, x);
            Float step = x - error / dr::maximum((theta + dt * x) * dr::exp(-x * x), (Scalar) 1e-12);
            x = dr::select(step >= low && step <= high, step, (Scalar) 0.5 * (low + high));
        }
        Float polar = dr::clip(theta + dt * x, 0, (Scalar) 0.5 * Pi);
        Float spread = dr::clip((2 * u.y() - 1) * dr::erf(Pi / dp), -AlmostOne, AlmostOne);
        auto [st, ct] = dr::sincos(polar);
        auto [sp, cp] = dr::sincos(phi + dp * dr::erfinv(spread));
        return Vector3f(st * cp, st * sp, ct);
    }
};

NAMESPACE_END(mitsuba)
