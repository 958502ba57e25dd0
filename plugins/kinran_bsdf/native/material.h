// The material file, as material.py and maps.py read and pack it. It is read with OpenEXR: the header of Mitsuba's
// own Bitmap needs one that its wheel does not hold.
#pragma once

#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfStringAttribute.h>

#include "models.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

namespace kinran {

using Matrix = std::array<std::array<double, 3>, 3>;

// ACEScg (AP1, D60) to linear Rec.709 (D65), Bradford adaptation
constexpr Matrix ToRec709 = { { { 1.704858676, -0.621716022, -0.083299372 },
                                { -0.130076824, 1.140735775, -0.010559802 },
                                { -0.023964073, -0.128975508, 1.153014019 } } };
constexpr std::array<double, 3> Luminance = { 0.212671, 0.715160, 0.072169 };

inline Matrix product(const Matrix &a, const Matrix &b) {
    Matrix c{};
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            for (int k = 0; k < 3; ++k)
                c[i][j] += a[i][k] * b[k][j];
    return c;
}

inline Matrix inverse(const Matrix &m) {
    Matrix c{};
    double det = 0;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            c[j][i] = m[(i + 1) % 3][(j + 1) % 3] * m[(i + 2) % 3][(j + 2) % 3] -
                      m[(i + 1) % 3][(j + 2) % 3] * m[(i + 2) % 3][(j + 1) % 3];
    for (int j = 0; j < 3; ++j)
        det += m[0][j] * c[j][0];
    for (auto &row : c)
        for (double &v : row)
            v /= det;
    return c;
}

/// Number or (nested) numbers of a key in a JSON text
inline std::vector<double> json_numbers(const std::string &text, const std::string &key) {
    std::vector<double> result;
    size_t at = key.empty() ? 0 : text.find('"' + key + '"');
    if (at == std::string::npos)
        throw std::runtime_error("a kinran: attribute lacks '" + key + "'");
    const char *p = text.c_str() + (key.empty() ? 0 : text.find(':', at) + 1);
    for (int depth = 0; *p;) {
        char *end;
        double value = std::strtod(p, &end);
        if (end != p) {
            result.push_back(value);
            p = end;
        } else {
            depth += *p == '[' ? 1 : *p == ']' ? -1 : 0;
            ++p;
        }
        if (depth <= 0 && !result.empty())
            break;
    }
    return result;
}

inline std::string json_text(const std::string &text, const std::string &key) {
    size_t at = text.find('"' + key + '"');
    size_t from = text.find('"', text.find(':', at + key.size() + 2)) + 1;
    return text.substr(from, text.find('"', from) - from);
}

/// CRC-32 as zlib computes it, of `size` bytes after those of `crc`
inline uint32_t crc32(const void *data, size_t size, uint32_t crc = 0) {
    static const auto table = [] {
        std::array<std::array<uint32_t, 256>, 8> t{};
        for (uint32_t i = 0; i < 256; ++i) {
            t[0][i] = i;
            for (int k = 0; k < 8; ++k)
                t[0][i] = (t[0][i] >> 1) ^ (t[0][i] & 1 ? 0xEDB88320u : 0);
        }
        for (uint32_t i = 0; i < 256; ++i)
            for (int k = 1; k < 8; ++k)
                t[k][i] = (t[k - 1][i] >> 8) ^ t[0][t[k - 1][i] & 255];
        return t;
    }();
    const uint8_t *p = (const uint8_t *) data;
    crc = ~crc;
    for (; size >= 8; size -= 8, p += 8) {
        crc ^= p[0] | p[1] << 8 | p[2] << 16 | (uint32_t) p[3] << 24;
        crc = table[7][crc & 255] ^ table[6][crc >> 8 & 255] ^ table[5][crc >> 16 & 255] ^ table[4][crc >> 24] ^
              table[3][p[4]] ^ table[2][p[5]] ^ table[1][p[6]] ^ table[0][p[7]];
    }
    for (; size; --size)
        crc = (crc >> 8) ^ table[0][(crc ^ *p++) & 255];
    return ~crc;
}

inline uint32_t crc32(const std::string &text, uint32_t crc = 0) { return crc32(text.data(), text.size(), crc); }

/// How the residual depends on the light: thin-plate splines over (l_x, l_y), as residual.py has them
struct Residual {
    std::string domain;
    double number = 1, share = 1;
    std::vector<double> lights, weights;
    size_t count = 0;

    /// Factor of each component under a light
    std::vector<double> basis(double x, double y) const {
        std::vector<double> result(count, 0.0);
        size_t n = lights.size() / 2;
        for (size_t i = 0; i < n + 3; ++i) {
            double kernel = i == n ? 1 : i == n + 1 ? x : y;
            if (i < n) {
                double dx = x - lights[2 * i], dy = y - lights[2 * i + 1], square = dx * dx + dy * dy;
                kernel = square > 0 ? 0.5 * square * std::log(square) : 0;
            }
            for (size_t k = 0; k < count; ++k)
                result[k] += kernel * weights[i * count + k];
        }
        return result;
    }
};

struct Material {
    size_t width = 0, height = 0;
    std::map<std::string, std::vector<float>> channels;
    const ModelInfo *model = nullptr;
    std::string tail;
    int lobes = 0;
    double theta_max = 0;
    Matrix from_stack{};
    bool has_residual = false;
    Residual residual;

    const std::vector<float> &plane(const std::string &name) const {
        auto it = channels.find(name);
        if (it == channels.end())
            throw std::runtime_error("has no channel '" + name + "', which model '" + model->name + "' needs; fit it again");
        return it->second;
    }
};

/// The model of this name
inline const ModelInfo &model_of(const std::string &name) {
    std::string list;
    for (const ModelInfo &model : ModelTable) {
        if (model.name == name)
            return model;
        list += (list.empty() ? "" : ", ") + model.name;
    }
    throw std::runtime_error("model '" + name + "' is not one of " + list + "; update the plugin");
}

inline void check(const Material &m) {
    if (std::find(Tails.begin(), Tails.end(), m.tail) == Tails.end())
        throw std::runtime_error("tail '" + m.tail + "' is not one of gaussian, ggx; update the plugin");
    if (m.lobes < m.model->least || m.lobes > m.model->most)
        throw std::runtime_error(std::to_string(m.lobes) + " lobes do not go with model '" + m.model->name + "'; fit it again");
    for (auto &[name, values] : m.channels)
        for (float v : values)
            if (!std::isfinite(v))
                throw std::runtime_error("channel '" + name + "' holds values that are not finite; fit it again");
    for (float v : m.plane("bound"))
        if (v <= 0 || v > 1)
            throw std::runtime_error("channel 'bound' leaves (0, 1]; fit it again");
    for (int k = 0; k <= m.lobes; ++k) {
        std::string term = k ? "lobe" + std::to_string(k) : "diffuse";
        const std::vector<float> &amplitude = m.plane(term + ".amplitude");
        for (float v : amplitude)
            if (v < 0)
                throw std::runtime_error("channel '" + term + ".amplitude' is negative; fit it again");
        if (!k)
            continue;
        bool takeda = m.model->model == Model::Takeda2008;
        const std::vector<float> &a = m.plane(term + (takeda ? ".dt" : ".xx")), &b = m.plane(term + (takeda ? ".dp" : ".yy")),
                                 &c = m.plane(term + (takeda ? ".dt" : ".xy"));
        for (size_t i = 0; i < a.size(); ++i)
            if (amplitude[i] > 0 && (a[i] <= 0 || b[i] <= 0 || (!takeda && a[i] * b[i] - c[i] * c[i] < 0)))
                throw std::runtime_error("texels of " + term + " have no positive width; fit it again");
    }
}

/// Refuse a file that contradicts the checksums in its header, as checksum.py describes them; without them nothing does
inline void check_sums(const Material &m, const Imf::Header &header) {
    std::string stated, lines;
    for (auto it = header.begin(); it != header.end(); ++it) {
        std::string name = it.name();
        const auto *value = dynamic_cast<const Imf::StringAttribute *>(&it.attribute());
        if (name == "kinran:crc32" && value)
            stated = value->value();
        else if (name.rfind("kinran:", 0) == 0 && value)
            lines += name + "=" + value->value() + "\n";
    }
    if (stated.empty())
        return;
    auto same = [&](const std::string &name, const std::string &what, uint32_t found) {
        char text[9];
        std::snprintf(text, sizeof text, "%08x", found);
        if (stated.find('"' + name + '"') == std::string::npos || json_text(stated, name) != text)
            throw std::runtime_error(what + " does not match the checksum in its header; write the material again");
    };
    same("kinran:", "a kinran: attribute", crc32(lines));
    std::string size = std::to_string(m.height) + " " + std::to_string(m.width) + "\n";
    for (auto &[name, values] : m.channels)
        same(name, "channel '" + name + "'", crc32(values.data(), values.size() * sizeof(float), crc32(size)));
}

inline Material read(const std::string &path) {
    Material m;
    Imf::InputFile file(path.c_str());
    const Imf::Header &header = file.header();
    auto text = [&](const std::string &key, bool needed = true) {
        const auto *value = header.findTypedAttribute<Imf::StringAttribute>("kinran:" + key);
        if (!value && needed)
            throw std::runtime_error("has no attribute kinran:" + key + "; it is not a Kinran material");
        return value ? value->value() : std::string();
    };
    if (text("version") != "1")
        throw std::runtime_error("kinran:version is '" + text("version") + "' but this plugin reads '1'; update one");
    if (text("cosine") != "included")
        throw std::runtime_error("kinran:cosine is '" + text("cosine") + "'; the plugin needs T = f_r cos θ ('included')");
    if (text("colour") != "lin_ap1_scene")
        throw std::runtime_error("colour space '" + text("colour") + "' is not 'lin_ap1_scene'; convert the maps");
    m.model = &model_of(text("model"));
    m.tail = text("tail", false).empty() ? Tails[0] : text("tail");
    m.lobes = std::atoi(text("lobes").c_str());
    m.theta_max = json_numbers(text("measured"), "theta_max").at(0);
    std::vector<double> matrix = json_numbers(text("from_stack"), "");
    for (size_t i = 0; i < 9; ++i)
        m.from_stack[i / 3][i % 3] = matrix.at(i);
    if (std::string json = text("residual", false); !json.empty()) {
        m.has_residual = true;
        Residual &r = m.residual;
        r.domain = json_text(json, "domain");
        if (size_t colon = r.domain.find(':'); colon != std::string::npos) {
            r.number = std::atof(r.domain.c_str() + colon + 1);
            r.domain.resize(colon);
        }
        r.share = json_numbers(json, "share").at(0);
        r.lights = json_numbers(json, "lights");
        r.weights = json_numbers(json, "weights");
        r.count = r.weights.size() / (r.lights.size() / 2 + 3);
    }
    Imath::Box2i window = header.dataWindow();
    m.width = (size_t) (window.max.x - window.min.x + 1);
    m.height = (size_t) (window.max.y - window.min.y + 1);
    Imf::FrameBuffer frame;
    for (auto it = header.channels().begin(); it != header.channels().end(); ++it) {
        std::vector<float> &plane = m.channels[it.name()];
        plane.resize(m.width * m.height);
        char *base = (char *) (plane.data() - window.min.x - (ptrdiff_t) (window.min.y * m.width));
        frame.insert(it.name(), Imf::Slice(Imf::FLOAT, base, sizeof(float), sizeof(float) * m.width));
    }
    file.setFrameBuffer(frame);
    file.readPixels(window.min.y, window.max.y);
    check_sums(m, header);
    check(m);
    return m;
}

/// Mean shape of a lobe over the texels that have it, for those that have not
inline std::vector<float> fill(const Material &m, const std::string &lobe) {
    const std::vector<float> &amplitude = m.plane(lobe + ".amplitude");
    std::vector<float> result;
    for (const auto &[s, neutral] : m.model->parameters) {
        const std::vector<float> &plane = m.plane(lobe + "." + s);
        double total = 0, sum = 0;
        for (size_t i = 0; i < plane.size(); ++i) {
            total += amplitude[i];
            sum += (double) amplitude[i] * plane[i];
        }
        result.push_back(total > 0 ? (float) (sum / total) : neutral);
    }
    return result;
}

inline void floor_widths(const Material &m, float *shape) {
    if (m.model->model == Model::Takeda2008) {
        shape[2] = std::max(shape[2], WidthFloor);
        shape[3] = std::max(shape[3], WidthFloor);
        return;
    }
    float xx = shape[2], xy = shape[3], yy = shape[4];
    float lack = std::max(WidthFloor * WidthFloor - (xx + yy - std::hypot(xx - yy, 2 * xy)) / 2, 0.f);
    shape[2] += lack;
    shape[4] += lack;
}

/// Colour · amplitude · bound in `bands` bands and shape, of the diffuse term and then of each lobe, texel by texel; lobes
/// that are filtered have their albedo in place of their amplitude; the maps of a residual and `bound` come last
inline std::vector<float> pack(const Material &m, size_t bands) {
    std::vector<float> result;
    std::vector<const std::vector<float> *> planes;
    std::vector<std::vector<float>> fills(m.lobes + 1);
    const std::vector<float> &bound = m.plane("bound");
    size_t count = 0;
    for (int k = 0; k <= m.lobes; ++k) {
        std::string term = k ? "lobe" + std::to_string(k) : "diffuse";
        std::vector<std::string> names = { "R", "G", "B", "amplitude" };
        for (const auto &[s, neutral] : k ? m.model->parameters : DiffuseParameters)
            names.push_back(s);
        for (const std::string &name : names)
            planes.push_back(&m.plane(term + "." + name));
        count += bands + names.size() - 4;
        if (k)
            fills[k] = fill(m, term);
    }
    std::vector<const std::vector<float> *> rest;
    for (size_t k = 0; m.has_residual && k <= m.residual.count; ++k)
        for (const char *c : { "R", "G", "B" })
            rest.push_back(&m.plane("residual" + std::to_string(k) + "." + c));
    if (m.has_residual)
        rest.push_back(&bound);
    mitsuba::Models<float> models{ m.model->model, false, 0.f };
    result.reserve(m.width * m.height * (count + rest.size()));
    for (size_t i = 0; i < m.width * m.height; ++i) {
        size_t at = 0;
        for (int k = 0; k <= m.lobes; ++k) {
            float amplitude = (*planes[at + 3])[i] * bound[i];
            std::array<float, 3> rgb;
            for (int c = 0; c < 3; ++c) {
                double sum = 0;
                for (int j = 0; j < 3; ++j)
                    sum += ToRec709[c][j] * (*planes[at + j])[i];
                rgb[c] = std::max((float) sum * amplitude, 0.f);
            }
            if (bands == 1)
                result.push_back((float) (Luminance[0] * rgb[0] + Luminance[1] * rgb[1] + Luminance[2] * rgb[2]));
            else
                result.insert(result.end(), rgb.begin(), rgb.end());
            at += 4;
            size_t shape = (k ? m.model->parameters : DiffuseParameters).size();
            for (size_t s = 0; s < shape; ++s)
                result.push_back(k && (*planes[at - 1])[i] <= 0 ? fills[k][s] : (*planes[at + s])[i]);
            float *last = result.data() + result.size() - shape;
            if (k)
                floor_widths(m, last);
            if (k && m.model->filtered) {
                mitsuba::Models<float>::Shape values{};
                std::copy(last, last + shape, values.begin());
                for (size_t b = 1; b <= bands; ++b)
                    last[-(ptrdiff_t) b] *= models.albedo(values);
            }
            at += shape;
        }
        for (const auto *plane : rest)
            result.push_back((*plane)[i]);
    }
    return result;
}

}  // namespace kinran
