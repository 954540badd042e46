#pragma once

#include "bsdf/bsdf.h"
#include "guide/caustic_guide.h"

// Directions from a mixture of a BSDF and a guide.

namespace raykiln {

/// Whether a guide is of use at a surface that is no mirror. Rough glass scatters into a
/// narrow lobe on either side: samples that a guide takes from them are missed.
template <class B>
inline bool is_guided(const B&) {
    return true;
}
template <class F>
inline bool is_guided(const Dielectric<F>&) {
    return false;
}
inline bool is_guided(const Bsdf& bsdf) {
    return !std::holds_alternative<Dielectric<float>>(bsdf);
}

/// A direction from the BSDF, or for the guide's share of the samples from the guide. The
/// weight is the value over the density of that mixture; `pdf_solid_angle` is the BSDF's
/// own density. Mirror directions stay the BSDF's alone.
///
/// The two ways of finding a light are weighted by the BSDF's own density as if there
/// were no guide: weights that add to 1 are all that is needed, and a guide knows nothing
/// of light that comes straight from a light.
template <class F, class B>
inline BsdfSample<F> sample_guided(const CausticGuide& guide, const GuideAt<F>& at,
                                   const B& bsdf, const Frame<F>& shading,
                                   const Vec3<F>& dir_out, const BsdfRandom<F>& u) {
    const auto mixed = at.share > F(0.0f);
    if (!any(mixed)) {
        return sample(bsdf, dir_out, u);
    }
    const auto guided = u.lobe < at.share;
    const F other = F(1.0f) - at.share;
    const F lobe = min(select(guided, u.lobe / select(mixed, at.share, F(1.0f)),
                              (u.lobe - at.share) / other),
                       F(one_minus_epsilon));
    BsdfSample<F> next = sample(bsdf, dir_out, {lobe, u.x, u.y});
    const Vec3<F> toward = shading.to_local(guide.sample(at, lobe, u.x, u.y));
    const BsdfValue<F> value = evaluate(bsdf, dir_out, toward);
    next.dir_in = select(guided, toward, next.dir_in);
    next.specular = next.specular & !guided;
    next.eta = select(guided, F(1.0f), next.eta);
    const Vec3<F> f = select(guided, value.value, next.weight * next.pdf_solid_angle);
    next.pdf_solid_angle = select(guided, value.pdf_solid_angle, next.pdf_solid_angle);

    const F pdf = next.pdf_solid_angle * other +
                  guide.pdf(at, shading.to_world(next.dir_in)) * at.share;
    const auto possible = pdf > F(0.0f);
    const Vec3<F> weight =
        select(possible, f / select(possible, pdf, F(1.0f)), Vec3<F>(F(0.0f)));
    // The guide's density makes weights small where light is strong: that is no reason
    // for roulette to end a path.
    const auto rivals =
        possible & (next.pdf_solid_angle > F(0.0f)) & mixed & !next.specular;
    const F ratio =
        select(rivals, pdf, F(1.0f)) / select(rivals, next.pdf_solid_angle, F(1.0f));
    next.eta = next.eta * sqrt(max(min(ratio, F(1e4f)), F(1.0f)));
    next.weight =
        select(mixed, select(next.specular, next.weight / other, weight), next.weight);
    return next;
}

}  // namespace raykiln
