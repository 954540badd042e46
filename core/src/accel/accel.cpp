#include "accel/accel.h"

#include <atomic>
#include <vector>

#include "accel/embree_api.h"
#include "accel/sphere_geometry.h"
#include "error.h"
#include "isa/isa.h"
#include "memory/pages.h"

namespace raykiln {

namespace {

// Less than this is found by the processor without looking.
constexpr std::size_t worth_moving = std::size_t{4} << 20;

bool count_memory(void* counter, ssize_t bytes, bool) {
    static_cast<std::atomic<std::int64_t>*>(counter)->fetch_add(bytes);
    return true;
}

void check(RTCDevice device) {
    const RTCError error = rtcGetDeviceError(device);
    if (error == RTC_ERROR_OUT_OF_MEMORY) {
        throw RenderError("there is not enough memory to build the scene");
    }
    if (error != RTC_ERROR_NONE) {
        throw RenderError("the ray tracer failed with error " +
                          std::to_string(static_cast<int>(error)));
    }
}

RTCGeometry make_mesh_geometry(RTCDevice device, const Mesh& mesh) {
    RTCGeometry g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                               mesh.positions, 0, 3 * sizeof(float), mesh.vertex_count);
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                               mesh.indices, 0, 3 * sizeof(std::uint32_t),
                               mesh.triangle_count);
    return g;
}

void move_arrays_to_huge_pages(const Scene& scene) {
    const auto move = [](const auto* array, std::size_t count) {
        const std::size_t bytes = count * sizeof(*array);
        if (array != nullptr && bytes >= std::size_t{64} << 10) {
            move_to_huge_pages(array, bytes);
        }
    };
    for (const Texture& texture : scene.textures) {
        if (const auto* image = std::get_if<ImageTexture>(&texture)) {
            move(static_cast<const unsigned char*>(image->pixels), image->bytes());
        }
    }
    for (const Group& group : scene.groups) {
        for (const Mesh& mesh : group.meshes) {
            const std::size_t vertices = mesh.vertex_count;
            move(mesh.positions, 3 * vertices);
            move(mesh.normals, 3 * vertices);
            move(mesh.uvs, 2 * vertices);
            move(mesh.indices, 3 * std::size_t{mesh.triangle_count});
        }
    }
}

RTCRay embree_ray(const Ray& ray) {
    RTCRay r;
    r.org_x = ray.origin.x;
    r.org_y = ray.origin.y;
    r.org_z = ray.origin.z;
    r.dir_x = ray.direction.x;
    r.dir_y = ray.direction.y;
    r.dir_z = ray.direction.z;
    r.tnear = ray.t_near;
    r.tfar = ray.t_far;
    r.time = 0.0f;
    r.mask = 0xffffffffu;
    r.id = 0;
    r.flags = 0;
    return r;
}

}  // namespace

struct Accel::Impl {
    std::atomic<std::int64_t> memory{0};
    RTCDevice device = nullptr;
    std::vector<RTCScene> group_scenes;  // [0] is the world
    std::uint32_t first_instance = 0;    // geometry id in the world
    std::uint32_t last_geometry = 0;     // one past it

    RTCScene new_scene() {
        RTCScene scene = rtcNewScene(device);
        rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
        rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_MEDIUM);
        return scene;
    }
    void attach(RTCScene scene, RTCGeometry geometry, std::uint32_t id) {
        rtcCommitGeometry(geometry);
        rtcAttachGeometryByID(scene, geometry, id);
        rtcReleaseGeometry(geometry);
    }
    void add_group(RTCScene target, const Group& group) {
        std::uint32_t id = 0;
        for (const Mesh& mesh : group.meshes) {
            attach(target, make_mesh_geometry(device, mesh), id++);
        }
        for (const Sphere& sphere : group.spheres) {
            attach(target, make_sphere_geometry(device, &sphere), id++);
        }
    }
    void add_instance(const Instance& instance, std::uint32_t id) {
        RTCGeometry g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_INSTANCE);
        rtcSetGeometryInstancedScene(g, group_scenes[instance.group]);
        const Transform& m = instance.world_from_group;
        const float columns[12] = {m.x.x, m.x.y,      m.x.z,      m.y.x,
                                   m.y.y, m.y.z,      m.z.x,      m.z.y,
                                   m.z.z, m.origin.x, m.origin.y, m.origin.z};
        rtcSetGeometryTransform(g, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, columns);
        attach(group_scenes[0], g, id);
    }
    ~Impl() {
        for (RTCScene scene : group_scenes) {
            rtcReleaseScene(scene);
        }
        if (device != nullptr) {
            rtcReleaseDevice(device);
        }
    }
};

Accel::Accel(const Scene& scene) : impl_(std::make_unique<Impl>()) {
    const NewMemory hierarchies;
    const std::string config = std::string("isa=") + isa_name(process_isa());
    impl_->device = rtcNewDevice(config.c_str());
    if (impl_->device == nullptr) {
        throw RenderError("the ray tracer could not be started");
    }
    rtcSetDeviceMemoryMonitorFunction(impl_->device, count_memory, &impl_->memory);
    for (std::size_t i = 0; i < scene.groups.size(); ++i) {
        impl_->group_scenes.push_back(impl_->new_scene());
    }
    // The world holds instances of the other groups, so it comes last.
    for (std::size_t i = scene.groups.size(); i-- > 0;) {
        RTCScene target = impl_->group_scenes[i];
        impl_->add_group(target, scene.groups[i]);
        if (i == 0) {
            impl_->first_instance = scene.groups[0].geometry_count();
            std::uint32_t id = impl_->first_instance;
            for (const Instance& instance : scene.instances) {
                impl_->add_instance(instance, id++);
            }
            impl_->last_geometry = id;
        }
        rtcCommitScene(target);
    }
    check(impl_->device);
    // Rays read them, and meshes and textures, here and there: this saves look-ups of
    // where a page is.
    if (memory_bytes() >= worth_moving) {
        hierarchies.move_to_huge_pages();
        move_arrays_to_huge_pages(scene);
    }
}

Accel::~Accel() = default;

Hit Accel::intersect(const Ray& ray) const {
    RTCRayHit rh;
    rh.ray = embree_ray(ray);
    rh.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rh.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    embree_intersect(impl_->group_scenes[0], rh);
    if (rh.hit.geomID == RTC_INVALID_GEOMETRY_ID) {
        return {};
    }
    const std::uint32_t inst = rh.hit.instID[0];
    return {rh.ray.tfar,
            rh.hit.u,
            rh.hit.v,
            {rh.hit.Ng_x, rh.hit.Ng_y, rh.hit.Ng_z},
            rh.hit.geomID,
            rh.hit.primID,
            inst == RTC_INVALID_GEOMETRY_ID ? no_index : inst - impl_->first_instance};
}

bool Accel::occluded(const Ray& ray) const {
    RTCRay r = embree_ray(ray);
    embree_occluded(impl_->group_scenes[0], r);
    return r.tfar < 0.0f;
}

template <int N>
void Accel::intersect(RayPacket<N>& packet, bool coherent) const {
    embree_intersect(impl_->group_scenes[0], packet, coherent);
    if (impl_->first_instance == impl_->last_geometry) {
        return;  // no instances
    }
    for (int i = 0; i < N; ++i) {
        const bool none = packet.instance[i] == no_index;
        packet.instance[i] -= none ? 0 : impl_->first_instance;
    }
}

template <int N>
void Accel::occluded(RayPacket<N>& packet) const {
    embree_occluded(impl_->group_scenes[0], packet);
}

template void Accel::intersect<4>(RayPacket<4>&, bool) const;
template void Accel::intersect<8>(RayPacket<8>&, bool) const;
template void Accel::intersect<16>(RayPacket<16>&, bool) const;
template void Accel::occluded<4>(RayPacket<4>&) const;
template void Accel::occluded<8>(RayPacket<8>&) const;
template void Accel::occluded<16>(RayPacket<16>&) const;

Bounds Accel::bounds() const {
    RTCBounds b;
    rtcGetSceneBounds(impl_->group_scenes[0], &b);
    return {{b.lower_x, b.lower_y, b.lower_z}, {b.upper_x, b.upper_y, b.upper_z}};
}

std::size_t Accel::memory_bytes() const {
    return static_cast<std::size_t>(std::max<std::int64_t>(0, impl_->memory.load()));
}

}  // namespace raykiln
