// The BSDF `kinran`, compiled: bsdf.py for the scalar variants and the command `mitsuba`. See docs/plugin.md.
#include <mitsuba/core/fresolver.h>
#include <mitsuba/core/properties.h>
#include <mitsuba/core/util.h>
#include <mitsuba/core/warp.h>
#include <mitsuba/render/bsdf.h>
#include <mitsuba/render/texture.h>
#include <drjit/tensor.h>
#include <drjit/texture.h>

#include "material.h"
#include "models.h"

NAMESPACE_BEGIN(mitsuba)

// Spectral primaries from 380 to 740 nm by 10 nm, as in colours.py; green is what they leave of 1
static const std::array<float, 37> Red = {
    .02831f, .02829f, .02822f, .02792f, .02692f, .02424f, .02008f, .01852f, .02929f, .01199f, 0, 0, 0, 0, 0, 0, 0, 0, 0,
    .01534f, .20631f, .47757f, .73938f, .9246f, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1
};
static const std::array<float, 37> Blue = {
    .97169f, .97171f, .97178f, .97208f, .97308f, .97576f, .97992f, .98148f, .97071f, .87847f, .70497f, .49203f, .2838f,
    .11226f, .009f, 0, 0, 0, 0, .04692f, .052f, .03436f, .0124f, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0
};

template <typename Float, typename Spectrum> class Kinran final : public BSDF<Float, Spectrum> {
public:
    MI_IMPORT_BASE(BSDF, m_flags, m_components)
    MI_IMPORT_TYPES(Texture)

    using Shape  = typename Models<Float>::Shape;
    using Values = dr::DynamicArray<Float>;

    static constexpr ScalarFloat Defensive = 0.1f;  // share of samples that terms get evenly
    static constexpr ScalarFloat ResidualLeast = 1e-6f;  // albedo of the diffuse term in sampling, at least
    static constexpr size_t Table = 128;            // side of the table of the residual's spline

    /// One term of the model at a point: colour · amplitude, its mean over bands, its shape, and its bands
    struct Term {
        UnpolarizedSpectrum colour;
        Float strength;
        Shape shape;
        std::array<Float, 3> bands;
    };

    /// What a look-up finds: the diffuse term, then the lobes; and the residual's maps and `bound`, if there are
    struct Texel {
        std::vector<Term> terms;
        std::vector<Float> residual;
    };

    Kinran(const Properties &props) : Base(props) {
        if (util::info_build(1).find("version " MI_VERSION) == std::string::npos)
            Throw("kinran: compiled for Mitsuba " MI_VERSION ", but this is another; compile it again (kinran native)");
        if (props.get<ScalarFloat>("pixel_angle", 0.f) > 0)
            Throw("kinran: pixel_angle needs the Python plugin; leave it out, or use `kinran render`");
        if (props.has_property("filename"))
            from_file(props);
        else
            from_textures(props);
        auto matrix = props.get<ScalarAffineTransform4f>("to_uv", ScalarAffineTransform4f()).matrix;
        for (int i = 0; i < 2; ++i)
            m_to_uv[i] = { (ScalarFloat) matrix(i, 0), (ScalarFloat) matrix(i, 1), (ScalarFloat) matrix(i, 3) };
        if (props.has_property("back"))
            m_back = props.get_texture<Texture>("back");
        set_flags();
    }

    void traverse(TraversalCallback *cb) override {
        if (m_names.empty())
            cb->put("maps", m_maps.tensor(), ParamFlags::Differentiable);
        for (size_t i = 0; i < m_names.size(); ++i)
            cb->put(m_names[i], m_textures[i], ParamFlags::Differentiable);
        if (m_back)
            cb->put("back", m_back, ParamFlags::Differentiable);
    }

    void parameters_changed(const std::vector<std::string> &keys) override {
        if (m_names.empty() && (keys.empty() || std::find(keys.begin(), keys.end(), "maps") != keys.end()))
            m_maps.set_tensor(m_maps.tensor());
    }

    std::pair<BSDFSample3f, Spectrum> sample(const BSDFContext &ctx, const SurfaceInteraction3f &si, Float sample1,
                                             const Point2f &sample2, Mask active) const override {
        MI_MASKED_FUNCTION(ProfilerPhase::BSDFSample, active);
        BSDFSample3f bs = dr::zeros<BSDFSample3f>();
        auto [enabled, back] = enabled_terms(ctx);
        Mask front = active && si.wi.z() > 0, behind = active && si.wi.z() < 0 && back;
        if (unlikely(dr::none_or<false>(front || behind)))
            return { bs, 0.f };
        Texel texel = fetch(si, front);
        const std::vector<Term> &terms = texel.terms;
        std::vector<Float> p = probabilities(terms, enabled);
        auto axes = fabric_axes(si);
        Vector3f v = to_fabric(axes, si.wi), light = warp::square_to_cosine_hemisphere(sample2);
        UInt32 component((uint32_t) m_lobes);
        if (m_lobes) {
            Mask first = sample1 < p[1], pick = sample1 < (m_lobes == 2 ? Float(p[1] + p[2]) : p[1]);
            Shape shape = terms[1].shape;
            if (m_lobes == 2)
                for (size_t i = 0; i < shape.size(); ++i)
                    shape[i] = dr::select(first, shape[i], terms[2].shape[i]);
            Vector3f h = m_models.sample(shape, sample2);
            light = dr::select(pick, reflect(v, Normal3f(h)), light);
            component = dr::select(pick, dr::select(first, UInt32(0), UInt32((uint32_t) m_lobes - 1)), component);
        }
        light = dr::detach(light);
        Mask good = front && light.z() > 0;
        Float pdf = dr::detach(density(terms, p, v, light));
        good &= pdf > 0;
        UnpolarizedSpectrum value = dr::select(
            good, this->value(si, texel, enabled, v, light) / dr::maximum(pdf, (ScalarFloat) 1e-20), 0.f);
        bs.wo = from_fabric(axes, light);
        bs.pdf = dr::select(good, pdf, 0.f);
        if (back) {
            Vector3f wo = warp::square_to_cosine_hemisphere(sample2);
            bs.wo = dr::select(behind, Vector3f(wo.x(), wo.y(), -wo.z()), bs.wo);
            bs.pdf = dr::select(behind, wo.z() * dr::InvPi<Float>, bs.pdf);
            value = dr::select(behind, m_back->eval(si, behind), value);
            component = dr::select(behind, UInt32((uint32_t) m_lobes + 1), component);
        }
        bs.eta = 1.f;
        bs.sampled_component = component;
        bs.sampled_type = dr::select(component < (uint32_t) m_lobes, UInt32(+BSDFFlags::GlossyReflection),
                                     UInt32(+BSDFFlags::DiffuseReflection));
        return { bs, depolarizer<Spectrum>(value) };
    }

    Spectrum eval(const BSDFContext &ctx, const SurfaceInteraction3f &si, const Vector3f &wo,
                  Mask active) const override {
        return eval_pdf(ctx, si, wo, active).first;
    }

    Float pdf(const BSDFContext &ctx, const SurfaceInteraction3f &si, const Vector3f &wo, Mask active) const override {
        return eval_pdf(ctx, si, wo, active).second;
    }

    std::pair<Spectrum, Float> eval_pdf(const BSDFContext &ctx, const SurfaceInteraction3f &si, const Vector3f &wo,
                                        Mask active) const override {
        MI_MASKED_FUNCTION(ProfilerPhase::BSDFEvaluate, active);
        UnpolarizedSpectrum result(0.f);
        Float pdf(0.f);
        auto [enabled, back] = enabled_terms(ctx);
        Mask seen = active && si.wi.z() > 0, front = seen && wo.z() > 0;
        if (!dr::none_or<false>(front) && std::find(enabled.begin(), enabled.end(), true) != enabled.end()) {
            Texel texel = fetch(si, seen);
            auto axes = fabric_axes(si);
            Vector3f v = to_fabric(axes, si.wi), l = to_fabric(axes, wo);
            result = dr::select(front, value(si, texel, enabled, v, l), 0.f);
            pdf = dr::select(front, density(texel.terms, probabilities(texel.terms, enabled), v, l), 0.f);
        }
        if (back) {
            Mask behind = active && si.wi.z() < 0 && wo.z() < 0;
            Float cosine = dr::select(behind, -wo.z() * dr::InvPi<Float>, 0.f);
            result += m_back->eval(si, behind) * cosine;
            pdf += cosine;
        }
        return { depolarizer<Spectrum>(result), dr::detach(pdf) };
    }

    Spectrum eval_diffuse_reflectance(const SurfaceInteraction3f &si, Mask active) const override {
        Term term = fetch(si, active).terms[0];
        return depolarizer<Spectrum>(term.colour * Models<Float>::diffuse_albedo(term.shape));
    }

    Mask has_attribute(const std::string &name, Mask active) const override {
        bool extra = m_names.empty() && (name == "bound" || name == "label");
        return active && Mask(extra || name == "measured_distance");
    }

    Float eval_attribute_1(const std::string &name, const SurfaceInteraction3f &si, Mask active) const override {
        if (name == "measured_distance")
            return dr::select(active, dr::safe_acos(dr::abs(si.wi.z())), 0.f);
        if (m_names.empty() && (name == "bound" || name == "label"))
            return look_up(m_extra, uv(si), active)[name == "label" ? 1 : 0];
        return Base::eval_attribute_1(name, si, active);
    }

    std::string to_string() const override {
        return "Kinran[model=" + m_name + ", lobes=" + std::to_string(m_lobes) + ", compiled: " KINRAN_STAMP "]";
    }

    MI_DECLARE_CLASS(Kinran)

private:
    // ------------------------------------------------------------------------------------------ loading

    static std::string choice(const Properties &props, const std::string &name, const std::string &preset,
                              const std::vector<std::string> &choices) {
        std::string value(props.get<std::string_view>(name, preset)), list;
        for (const std::string &c : choices)
            list += (list.empty() ? "" : ", ") + c;
        if (std::find(choices.begin(), choices.end(), value) == choices.end())
            Throw("kinran: %s '%s' is not one of %s", name, value, list);
        return value;
    }

    void set_model(const kinran::ModelInfo &model, const std::string &tail, int lobes, double floor) {
        m_name = model.name;
        m_filtered = model.filtered;
        m_models.model = model.model;
        m_models.ggx = tail == kinran::Tails[1];
        m_models.floor = dr::opaque<Float>((ScalarFloat) floor);
        m_lobes = (size_t) lobes;
        m_shape = model.parameters.size();
    }

    static Texture2f texture(const std::vector<float> &values, size_t height, size_t width, dr::FilterMode filter,
                             dr::WrapMode wrap) {
        size_t shape[3] = { height, width, values.size() / (height * width) };
        return Texture2f(TensorXf(values.data(), 3, shape), false, false, filter, wrap);
    }

    void from_file(const Properties &props) {
        std::string path = file_resolver()->resolve(props.get<std::string_view>("filename")).string();
        kinran::Material m;
        try {
            m = kinran::read(path);
        } catch (const std::exception &error) {
            Throw("%s: %s", path, error.what());
        }
        set_model(*m.model, m.tail, m.lobes,
                  std::min(std::cos(85 * dr::Pi<double> / 180), std::max(std::cos(m.theta_max), 1e-3)));
        std::string filter = choice(props, "filter", m_filtered ? "bilinear" : "nearest", { "nearest", "bilinear" });
        if (!m_filtered && filter != "nearest")
            Throw("kinran: filter 'bilinear' would average angles of %s; use 'nearest' or fit slope", m_name);
        bool repeat = choice(props, "wrap_mode", "repeat", { "repeat", "clamp" }) == "repeat";
        auto mode = filter == "nearest" ? dr::FilterMode::Nearest : dr::FilterMode::Linear;
        auto wrap = repeat ? dr::WrapMode::Repeat : dr::WrapMode::Clamp;
        m_bands = is_monochromatic_v<Spectrum> && !m.has_residual ? 1 : 3;
        m_maps = texture(kinran::pack(m, m_bands), m.height, m.width, mode, wrap);
        std::vector<float> extra;
        for (size_t i = 0; i < m.width * m.height; ++i) {
            extra.push_back(m.plane("bound")[i]);
            extra.push_back(m.plane("label")[i]);
        }
        m_extra = texture(extra, m.height, m.width, dr::FilterMode::Nearest, wrap);
        if constexpr (is_spectral_v<Spectrum>) {
            std::vector<float> values;
            for (size_t i = 0; i < Red.size(); ++i)
                values.insert(values.end(), { Red[i], 1 - Red[i] - Blue[i], Blue[i] });
            size_t shape[2] = { Red.size(), 3 };
            m_primaries = Texture1f(TensorXf(values.data(), 2, shape), false, false);
        }
        if (m.has_residual)
            set_residual(m);
    }

    void set_residual(const kinran::Material &m) {
        m_count = m.residual.count;
        m_domain = m.residual.domain;
        m_number = (ScalarFloat) m.residual.number;
        m_share = (ScalarFloat) m.residual.share;
        if (m_domain != "srgb" && m_domain != "linear" && m_domain != "gamma" && m_domain != "log")
            Throw("kinran: unknown domain '%s' of a residual; update the plugin", m_domain);
        std::vector<float> table;
        for (size_t i = 0; i < Table * Table; ++i)
            for (double f : m.residual.basis((i % Table + 0.5) / Table * 2 - 1, (i / Table + 0.5) / Table * 2 - 1))
                table.push_back((float) f);
        m_table = texture(table, Table, Table, dr::FilterMode::Linear, dr::WrapMode::Clamp);
        kinran::Matrix to_stack = kinran::inverse(kinran::product(kinran::ToRec709, m.from_stack));
        for (auto &row : to_stack)
            for (double &v : row)
                v *= dr::Pi<double>;
        m_to_stack = to_stack;
        m_from_stack = kinran::inverse(to_stack);
    }

    void from_textures(const Properties &props) {
        std::vector<std::string> names;
        for (const kinran::ModelInfo &model : kinran::ModelTable)
            names.push_back(model.name);
        const kinran::ModelInfo &model = kinran::model_of(choice(props, "model", "slope", names));
        std::string tail = choice(props, "tail", kinran::Tails[0], kinran::Tails);
        int lobes = model.least;
        for (int n = lobes; n <= model.most; ++n)
            lobes = n && props.has_property("lobe" + std::to_string(n)) ? n : lobes;
        set_model(model, tail, lobes, std::cos(85 * dr::Pi<double> / 180));
        auto add = [&](const std::string &name, ScalarFloat preset, bool colour) {
            m_names.push_back(name);
            m_textures.push_back(colour ? props.get_texture<Texture>(name, preset)
                                        : props.get_unbounded_texture<Texture>(name, preset));
        };
        for (int k = 0; k <= lobes; ++k) {
            std::string name = k ? "lobe" + std::to_string(k) : "diffuse";
            add(name, .5f, true);
            add(name + "_amplitude", k ? 1.f : dr::InvPi<ScalarFloat>, false);
            for (const auto &[parameter, neutral] : k ? model.parameters : kinran::DiffuseParameters)
                add(name + "_" + parameter, neutral, false);
        }
    }

    void set_flags() {
        uint32_t common = BSDFFlags::Anisotropic | BSDFFlags::SpatiallyVarying | BSDFFlags::FrontSide;
        uint32_t glossy = +BSDFFlags::GlossyReflection, diffuse = +BSDFFlags::DiffuseReflection;
        for (size_t k = 0; k < m_lobes; ++k)
            m_components.push_back(glossy | common);
        m_components.push_back(diffuse | common);
        if (m_back)
            m_components.push_back(BSDFFlags::DiffuseReflection | BSDFFlags::SpatiallyVarying | BSDFFlags::BackSide);
        m_flags = m_components[0];
        for (uint32_t flags : m_components)
            m_flags |= flags;
    }

    // ---------------------------------------------------------------------------------------- at a point

    Point2f uv(const SurfaceInteraction3f &si) const {
        const auto &m = m_to_uv;
        return Point2f(m[0][0] * si.uv.x() + m[0][1] * si.uv.y() + m[0][2],
                       m[1][0] * si.uv.x() + m[1][1] * si.uv.y() + m[1][2]);
    }

    static Values look_up(const Texture2f &texture, const Point2f &uv, const Mask &active) {
        return texture.template eval<Values>(dr::Array<Float, 2>(uv.x(), uv.y()), active);
    }

    Texel fetch(const SurfaceInteraction3f &si, Mask active) const {
        Texel texel;
        std::vector<Term> &terms = texel.terms;
        terms.resize(m_lobes + 1);
        size_t at = 0;
        if (!m_names.empty()) {
            for (size_t k = 0; k <= m_lobes; ++k) {
                Float amplitude = dr::maximum(m_textures[at + 1]->eval_1(si, active), 0.f);
                terms[k].colour = m_textures[at]->eval(si, active) * amplitude;
                terms[k].strength = dr::mean(terms[k].colour);
                at += 2;
                size_t count = k ? m_shape : 2;
                for (size_t i = 0; i < count; ++i)
                    terms[k].shape[i] = m_textures[at + i]->eval_1(si, active);
                if (k)
                    terms[k].shape = m_models.confined(terms[k].shape);
                at += count;
            }
            return texel;
        }
        Values values = look_up(m_maps, uv(si), active);
        for (size_t k = 0; k <= m_lobes; ++k) {
            for (size_t c = 0; c < m_bands; ++c)
                terms[k].bands[c] = values[at++];
            for (size_t i = 0; i < (k ? m_shape : 2); ++i)
                terms[k].shape[i] = values[at++];
            Float inverse = 1.f;
            if (k && m_filtered)
                inverse = dr::rcp(dr::maximum(m_models.albedo(terms[k].shape), (ScalarFloat) 1e-12));
            terms[k].strength = 0.f;
            for (size_t c = 0; c < m_bands; ++c) {
                terms[k].bands[c] *= inverse;
                terms[k].strength += terms[k].bands[c] / (ScalarFloat) m_bands;
            }
            terms[k].colour = spectrum(si, terms[k].bands, active);
        }
        while (at < values.size())
            texel.residual.push_back(values[at++]);
        return texel;
    }

    UnpolarizedSpectrum spectrum(const SurfaceInteraction3f &si, const std::array<Float, 3> &bands, Mask active) const {
        UnpolarizedSpectrum result;
        if constexpr (is_spectral_v<Spectrum>) {
            for (size_t i = 0; i < UnpolarizedSpectrum::Size; ++i) {
                Float at = ((si.wavelengths[i] - 380.f) / 10.f + .5f) / (ScalarFloat) Red.size();
                Values p = m_primaries.template eval<Values>(dr::Array<Float, 1>(at), active);
                result[i] = bands[0] * p[0] + bands[1] * p[1] + bands[2] * p[2];
            }
        } else if constexpr (is_monochromatic_v<Spectrum>) {
            result = bands[0];
            if (m_bands == 3)
                result = (ScalarFloat) kinran::Luminance[0] * bands[0] + (ScalarFloat) kinran::Luminance[1] * bands[1] +
                         (ScalarFloat) kinran::Luminance[2] * bands[2];
        } else {
            result = UnpolarizedSpectrum(bands[0], bands[1], bands[2]);
        }
        return result;
    }

    struct Axes {
        Float c, s, sign;  // cosine and sine of the weft in the shading frame, and the sign that makes the warp +v
    };

    Axes fabric_axes(const SurfaceInteraction3f &si) const {
        ScalarFloat a = m_to_uv[0][0], b = m_to_uv[0][1], c = m_to_uv[1][0], d = m_to_uv[1][1], det = a * d - b * c;
        Float sign = dr::select(dr::dot(si.sh_frame.t, si.dp_dv) < 0, Float(-1.f), Float(1.f));
        if (b == 0 && c == 0 && a > 0)
            return { 1.f, 0.f, sign * (d < 0 ? -1.f : 1.f) };
        Vector3f along = (si.dp_du * d - si.dp_dv * c) / det;  // first column of the inverse
        Float x = dr::dot(si.sh_frame.s, along), y = dr::dot(si.sh_frame.t, along);
        Float length = dr::maximum(dr::sqrt(x * x + y * y), (ScalarFloat) 1e-20);
        return { x / length, y / length, sign * (det < 0 ? -1.f : 1.f) };
    }

    static Vector3f to_fabric(const Axes &a, const Vector3f &w) {
        return Vector3f(a.c * w.x() + a.s * w.y(), a.sign * (a.c * w.y() - a.s * w.x()), w.z());
    }

    static Vector3f from_fabric(const Axes &a, const Vector3f &w) {
        Float y = a.sign * w.y();
        return Vector3f(a.c * w.x() - a.s * y, a.s * w.x() + a.c * y, w.z());
    }

    std::pair<std::vector<bool>, bool> enabled_terms(const BSDFContext &ctx) const {
        std::vector<bool> enabled = { ctx.is_enabled(BSDFFlags::DiffuseReflection, (uint32_t) m_lobes) };
        for (size_t k = 0; k < m_lobes; ++k)
            enabled.push_back(ctx.is_enabled(BSDFFlags::GlossyReflection, (uint32_t) k));
        return { enabled, m_back && ctx.is_enabled(BSDFFlags::DiffuseReflection, (uint32_t) m_lobes + 1) };
    }

    std::vector<Float> probabilities(const std::vector<Term> &terms, const std::vector<bool> &enabled) const {
        std::vector<Float> weights;
        Float total(0.f), sum(0.f);
        ScalarFloat count = 0;
        for (size_t k = 0; k < terms.size(); ++k) {
            Float unit = k ? m_models.albedo(terms[k].shape) : dr::Pi<Float>;
            ScalarFloat least = m_count && k == 0 ? ResidualLeast : (ScalarFloat) 0;
            Float weight = dr::maximum(dr::maximum(terms[k].strength, 0.f) * unit, least);
            weights.push_back(enabled[k] ? Float(dr::detach(weight)) : Float(0.f));
            total += weights.back();
            count += enabled[k] ? 1 : 0;
        }
        Float share = count > 0 ? Float(Defensive / count * total) : Float(0.f);
        for (Float &w : weights) {
            w = dr::select(w > 0, w + share, 0.f);
            sum += w;
        }
        for (Float &w : weights)
            w /= dr::maximum(sum, (ScalarFloat) 1e-20);
        return weights;
    }

    Float density(const std::vector<Term> &terms, const std::vector<Float> &p, const Vector3f &v,
                  const Vector3f &l) const {
        Float density = p[0] * l.z() * dr::InvPi<Float>;
        for (size_t k = 1; k < terms.size(); ++k)
            density += p[k] * m_models.density(terms[k].shape, v, l);
        return density;
    }

    UnpolarizedSpectrum value(const SurfaceInteraction3f &si, const Texel &texel, const std::vector<bool> &enabled,
                              const Vector3f &v, const Vector3f &l) const {
        const std::vector<Term> &terms = texel.terms;
        UnpolarizedSpectrum value(0.f);
        bool whole = m_count && enabled[0];  // a residual goes with the diffuse term
        std::array<Float, 3> bands{ 0.f, 0.f, 0.f };
        if (whole)
            bands = residual(texel, v, l);
        for (size_t k = 0; k < terms.size(); ++k) {
            if (!enabled[k])
                continue;
            Float f = factor(terms, k, v, l);
            value += terms[k].colour * f;
            for (size_t c = 0; whole && c < 3; ++c)
                bands[c] += f * terms[k].bands[c];
        }
        for (Float &b : bands)
            b = dr::maximum(b, 0.f);
        return whole ? spectrum(si, bands, true) : value;
    }

    Float factor(const std::vector<Term> &terms, size_t k, const Vector3f &v, const Vector3f &l) const {
        return k ? m_models.lobe(v, l, terms[k].shape) : m_models.diffuse_lift(v, l, terms[k].shape);
    }

    /// Residual at the light that has the same half vector at the measured view, fading out beyond it; Rec. 709
    std::array<Float, 3> residual(const Texel &texel, const Vector3f &v, const Vector3f &l) const {
        const std::vector<Float> &values = texel.residual;
        Vector3f h = dr::normalize(v + l), view(0.f, 0.f, 1.f);
        Vector3f light(2 * h.z() * h.x(), 2 * h.z() * h.y(), 2 * h.z() * h.z() - 1);
        Mask measured = light.z() >= m_models.floor;
        Values factors = look_up(m_table, Point2f(.5f * light.x() + .5f, .5f * light.y() + .5f), measured);
        Float bound = dr::maximum(values[3 * (m_count + 1)], (ScalarFloat) 1e-3);
        Float fade = dr::select(measured, Models<Float>::release(v, l), 0.f);
        std::array<Float, 3> lobes{ 0.f, 0.f, 0.f }, shown, change;
        for (size_t k = 0; k < texel.terms.size(); ++k) {
            Float f = factor(texel.terms, k, view, light);
            for (size_t c = 0; c < 3; ++c)
                lobes[c] += f * texel.terms[k].bands[c];
        }
        for (size_t c = 0; c < 3; ++c) {
            Float left = values[c], linear(0.f);
            for (size_t k = 0; k < m_count; ++k)
                left += values[3 * (k + 1) + c] * factors[k];
            for (size_t j = 0; j < 3; ++j)
                linear += (ScalarFloat) m_to_stack[c][j] * lobes[j] / bound;
            shown[c] = expand(m_share * compress(linear) + left);
        }
        for (size_t c = 0; c < 3; ++c) {
            Float whole(0.f);
            for (size_t j = 0; j < 3; ++j)
                whole += (ScalarFloat) m_from_stack[c][j] * shown[j];
            change[c] = fade * (whole * bound - lobes[c]);
        }
        return change;
    }

    static constexpr ScalarFloat LogCompression = 500.f;

    Float compress(const Float &light) const {
        Float x = dr::maximum(light, 0.f);
        if (m_domain == "linear")
            return x;
        if (m_domain == "gamma")
            return dr::pow(x, 1 / m_number);
        if (m_domain == "log")
            return dr::log(1 + x * (LogCompression / m_number)) / std::log1p(LogCompression);
        return dr::select(x <= 0.0031308f, 12.92f * x,
                          1.055f * dr::pow(dr::maximum(x, 0.0031308f), (ScalarFloat) (1 / 2.4)) - 0.055f);
    }

    Float expand(const Float &value) const {
        Float y = dr::maximum(value, 0.f);
        if (m_domain == "linear")
            return y;
        if (m_domain == "gamma")
            return dr::pow(y, m_number);
        if (m_domain == "log")
            return (dr::exp(y * std::log1p(LogCompression)) - 1) * (m_number / LogCompression);
        return dr::select(y <= 0.04045f, y / 12.92f, dr::pow((dr::maximum(y, 0.04045f) + 0.055f) / 1.055f, 2.4f));
    }

    std::string m_name;
    bool m_filtered = true;
    Models<Float> m_models;
    size_t m_lobes = 0, m_shape = 0, m_bands = 3, m_count = 0;
    std::array<std::array<ScalarFloat, 3>, 2> m_to_uv;
    std::vector<std::string> m_names;  // of textures; empty with a material file
    std::vector<ref<Texture>> m_textures;
    ref<Texture> m_back;
    Texture2f m_maps, m_extra, m_table;
    Texture1f m_primaries;
    std::string m_domain;
    ScalarFloat m_number = 1, m_share = 1;
    kinran::Matrix m_to_stack{}, m_from_stack{};

    MI_TRAVERSE_CB(Base, m_textures, m_back, m_maps, m_extra, m_table, m_primaries)
};

MI_EXPORT_PLUGIN(Kinran)
NAMESPACE_END(mitsuba)
