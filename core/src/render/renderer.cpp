#include "render/renderer.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/global_control.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>
#include <tbb/task_group.h>

#include <algorithm>
#include <chrono>
#include <exception>
#include <future>

#include "camera/camera.h"

namespace raykiln {

namespace {

constexpr int tile_size = 16;
constexpr std::chrono::milliseconds poll_interval{20};

}  // namespace

Renderer::Renderer(const Scene& scene, const Accel& accel, const Camera& camera,
                   const RenderOptions& options) :
    scene_(scene),
    accel_(accel),
    camera_(camera),
    options_(options),
    filter_(options.filter),
    film_(options.crop_x1 - options.crop_x0, options.crop_y1 - options.crop_y0,
          options.layers),
    threads_(options.threads > 0 ? options.threads : tbb::info::default_concurrency()) {
    for (int y = 0; y < film_.height(); y += tile_size) {
        for (int x = 0; x < film_.width(); x += tile_size) {
            tiles_.push_back({x, y, std::min(x + tile_size, film_.width()),
                              std::min(y + tile_size, film_.height())});
        }
    }
}

Renderer::~Renderer() = default;

void Renderer::resume() {
    const auto& counts = film_.counts();
    samples_done_ = *std::min_element(counts.begin(), counts.end());
    std::uint64_t total = 0;
    for (const std::uint32_t count : counts) {
        total += count;
    }
    pixel_samples_ = total;
}

bool Renderer::run_pass(const Poll& poll) {
    if (finished()) {
        return true;
    }
    const std::uint32_t end = next_pass(samples_done_, options_.spp);
    stop_ = false;
    tbb::enumerable_thread_specific<RayCounts> counts;
    // More threads than cores are allowed if they are asked for.
    const tbb::global_control limit(
        tbb::global_control::max_allowed_parallelism,
        static_cast<std::size_t>(std::max(threads_, tbb::info::default_concurrency())) +
            1);
    // One slot more than threads: the caller polls and does not render.
    tbb::task_arena arena(threads_, 0);
    std::promise<void> done;
    auto finished_pass = done.get_future();
    arena.enqueue([&] {
        try {
            tbb::parallel_for(
                std::size_t{0}, tiles_.size(),
                [&](std::size_t i) { render_tile(tiles_[i], end, counts.local()); },
                tbb::simple_partitioner());
            done.set_value();
        } catch (...) {
            done.set_exception(std::current_exception());
        }
    });
    bool wanted = true;
    std::exception_ptr error;
    while (finished_pass.wait_for(poll_interval) != std::future_status::ready) {
        if (!wanted) {
            continue;
        }
        try {
            wanted = poll(pixel_samples_);
        } catch (...) {
            error = std::current_exception();
            wanted = false;
        }
        stop_ = !wanted;
    }
    finished_pass.get();
    for (const RayCounts& c : counts) {
        counts_ += c;
    }
    if (error) {
        std::rethrow_exception(error);
    }
    if (wanted) {
        samples_done_ = end;
    }
    return wanted;
}

void Renderer::render_tile(const Tile& tile, std::uint32_t end, RayCounts& counts) {
    std::uint64_t samples = 0;
    for (int y = tile.y0; y < tile.y1 && !stop_.load(std::memory_order_relaxed); ++y) {
        for (int x = tile.x0; x < tile.x1 && !stop_.load(std::memory_order_relaxed);
             ++x) {
            samples += end - std::min(end, film_.count(x, y));
            render_pixel(x, y, end, counts);
        }
    }
    pixel_samples_ += samples;
}

void Renderer::render_pixel(int x, int y, std::uint32_t end, RayCounts& counts) {
    const std::uint32_t begin = film_.count(x, y);
    if (begin >= end) {
        return;
    }
    PixelSums sums;
    for (std::uint32_t index = begin; index < end; ++index) {
        FirstHit first;
        const Vec3f radiance = render_sample(x + options_.crop_x0, y + options_.crop_y0,
                                             index, counts, first);
        if (!is_finite(radiance)) {
            ++counts.nonfinite;
        } else {
            sums.radiance += radiance;
            sums.luminance_squared += sqr(luminance(radiance));
        }
        if (first.valid) {
            sums.albedo += first.albedo;
            sums.normal += first.normal;
            sums.depth += first.depth;
            sums.depth_weight += 1.0f;
        }
    }
    film_.add(x, y, sums, end);
}

Vec3f Renderer::render_sample(int x, int y, std::uint32_t index, RayCounts& counts,
                              FirstHit& first) {
    const SampleKey<float> key = sample_key(options_.seed, static_cast<std::uint32_t>(x),
                                            static_cast<std::uint32_t>(y), index);
    const Context c{scene_, accel_, options_.estimator, key, counts};
    const Sample4<float> u = c.draw(camera_group);
    const float px = static_cast<float>(x) + 0.5f + filter_.offset(u[0]);
    const float py = static_cast<float>(y) + 0.5f + filter_.offset(u[1]);
    const Ray ray = camera_ray(camera_, px / static_cast<float>(options_.width),
                               py / static_cast<float>(options_.height));
    ++counts.camera;
    Vec3f radiance;
    switch (options_.estimator.integrator) {
        case IntegratorKind::path:
            radiance = estimate_path(c, ray, first);
            break;
        case IntegratorKind::whitted:
            radiance = estimate_whitted(c, ray, first);
            break;
        case IntegratorKind::direct:
            radiance = estimate_direct(c, ray, first);
            break;
        case IntegratorKind::ao:
            radiance = estimate_ao(c, ray, first);
            break;
    }
    if (first.valid) {
        first.depth = view_depth(camera_, first.point);
    }
    return radiance;
}

}  // namespace raykiln
