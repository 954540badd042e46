#include "isa/isa.h"

#include <gtest/gtest.h>

#include <vector>

#include "error.h"
#include "sampling/sampler.h"
#include "statistics.h"
#include "wide/dispatch.h"

namespace raykiln {
namespace {

std::vector<Isa> runnable() {
    std::vector<Isa> found;
    for (const Isa isa : {Isa::sse42, Isa::avx2, Isa::avx512}) {
        try {
            found.push_back(select_isa(isa_name(isa)));
        } catch (const SettingsError&) {
        }
    }
    return found;
}

TEST(Isa, TheBestThatRunsIsTheDefault) {
    ASSERT_FALSE(runnable().empty());
    EXPECT_EQ(select_isa(nullptr), runnable().back());
    EXPECT_EQ(select_isa(""), runnable().back());
}

TEST(Isa, ANameThatIsNotAcceptedIsAnErrorThatListsThoseThatAre) {
    for (const char* name : {"avx", "AVX2", "sse4.2 ", "x86-64-v3", "1"}) {
        try {
            select_isa(name);
            FAIL() << name;
        } catch (const SettingsError& error) {
            const std::string text = error.what();
            EXPECT_NE(text.find("RAYKILN_ISA"), std::string::npos);
            EXPECT_NE(text.find(name), std::string::npos);
            EXPECT_NE(text.find("sse4.2"), std::string::npos);
        }
    }
}

TEST(Isa, EachHasKernelsOfItsOwnWhichDrawTheSameSamples) {
    constexpr std::size_t count = 1001;  // no multiple of any width
    test::Rng rng(1);
    std::vector<std::uint32_t> pixel(count), index(count);
    for (std::size_t i = 0; i < count; ++i) {
        pixel[i] = static_cast<std::uint32_t>(rng.bits());
        index[i] = static_cast<std::uint32_t>(rng.bits() >> 12) >> (i % 20);
    }
    for (const Isa isa : runnable()) {
        const WideKernels& kernels = wide_kernels(isa);
        EXPECT_STREQ(kernels.isa, isa_name(isa));
        EXPECT_EQ(kernels.width, isa == Isa::avx512 ? 16 : isa == Isa::avx2 ? 8 : 4);
        std::vector<float> drawn(4 * count + 1, 77.0f);
        kernels.sobol_samples(pixel.data(), index.data(), count, 5, drawn.data());
        for (std::size_t i = 0; i < count; ++i) {
            const auto expected = sobol_sample(SampleKey<float>{pixel[i], index[i]}, 5);
            for (std::size_t d = 0; d < 4; ++d) {
                ASSERT_EQ(drawn[4 * i + d], expected[d]) << kernels.isa << " " << i;
            }
        }
        EXPECT_EQ(drawn.back(), 77.0f);
    }
}

}  // namespace
}  // namespace raykiln
