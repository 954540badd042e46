#pragma once

#include "bsdf/bsdf.h"
#include "guide/caustic_guide.h"

// Directions from a mixture of a BSDF and a guide.

namespace raykiln {

/// Density of the mixture, given that of the BSDF's own sampling.
template <class F>
inline F pdf_guided(const CausticGuide& guide, const GuideAt<F>& at, F pdf_bsdf,
                    const Vec3<F>& direction) {
    if (!any(at.share > F(0.0f))) {
        return pdf_bsdf;
    }
    const F mixed = pdf_bsdf + at.share * (guide.pdf(at, direction) - pdf_bsdf);
    return select(at.share > F(0.0f), mixed, pdf_bsdf);
}

/// A direction from the BSDF, or for the guide's share of the samples from the guide;
/// `pdf_solid_angle` is the mixture's. Mirror directions stay the BSDF's alone.
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
    const F which =
        select(guided, u.lobe / select(mixed, at.share, F(1.0f)), (u.lobe - at.share) / other);
    const F lobe = min(which, F(one_minus_epsilon));
    const BsdfSample<F> own = sample(bsdf, dir_out, {lobe, u.x, u.y});
    const Vec3<F> toward = shading.to_local(guide.sample(at, lobe, u.x, u.y));
    const BsdfValue<F> value = evaluate(bsdf, dir_out, toward);

    BsdfSample<F> next = own;
    next.dir_in = select(guided, toward, own.dir_in);
    next.specular = own.specular & !guided;
    next.eta = select(guided, F(1.0f), own.eta);
    const F pdf_bsdf = select(guided, value.pdf_solid_angle, own.pdf_solid_angle);
    const F pdf = pdf_guided(guide, at, pdf_bsdf, shading.to_world(next.dir_in));
    const Vec3<F> f = select(guided, value.value, own.weight * own.pdf_solid_angle);
    const auto possible = pdf > F(0.0f);
    Vec3<F> weight = f / select(possible, pdf, F(1.0f));
    weight = select(next.specular, own.weight / other, weight);
    next.weight = select(mixed, select(possible | next.specular, weight, Vec3<F>(F(0.0f))),
                         own.weight);
    next.pdf_solid_angle = select(mixed, pdf, own.pdf_solid_angle);
    return next;
}

}  // namespace raykiln
