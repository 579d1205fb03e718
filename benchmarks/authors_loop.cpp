// Weight gradients at the vertices of a skinned mesh by a loop over triangles: the peer of skinbake's own.
//
//     authors_loop MESH REPEATS [GRADIENTS]
//
// prints the seconds of each repeat, one a line, without reading and writing. This is the computation that
// Tarini, Panozzo and Sorkine-Hornung published with "Accurate and Efficient Lighting for Skinned Models"
// (Computer Graphics Forum 33(2), 2014), written from its description, not from their code:
//
//   * weights are linear on a triangle, so each influence has one constant gradient there;
//   * a vertex takes the mean over its triangles, weighted by the angle at the vertex times the area;
//   * each slot is normalised by the triangles on which its weight varies, not by all of them.
//
// MESH, little-endian: int64 vertices, triangles; float32 positions (V, 3); int32 triangles (T, 3);
// int32 joints (V, 4); float32 weights (V, 4). GRADIENTS gets float32 (V, 4, 3), per slot.

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

constexpr int kSlots = 4;

struct Vec3 {
    float x, y, z;
};

Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Vec3 operator*(Vec3 a, float s) { return {a.x * s, a.y * s, a.z * s}; }
float dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Vec3 cross(Vec3 a, Vec3 b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
float length(Vec3 a) { return std::sqrt(dot(a, a)); }

struct Triangle {
    std::int32_t corner[3];
};

struct Influences {
    std::int32_t joint[kSlots];
};

struct Weights {
    float of[kSlots];
};

struct Mesh {
    std::vector<Vec3> positions;
    std::vector<Triangle> triangles;
    std::vector<Influences> influences;
    std::vector<Weights> weights;

    // The weight of a joint at a vertex, 0 where none of its slots names the joint.
    float weight(std::int32_t vertex, std::int32_t joint) const {
        for (int slot = 0; slot < kSlots; ++slot) {
            if (influences[vertex].joint[slot] == joint) return weights[vertex].of[slot];
        }
        return 0.0f;
    }
};

struct SlotGradients {
    Vec3 of[kSlots];
};

struct SlotTotals {
    float of[kSlots];
};

std::vector<SlotGradients> weight_gradients(const Mesh& mesh) {
    std::vector<SlotGradients> gradients(mesh.positions.size());
    std::vector<SlotTotals> totals(mesh.positions.size());
    for (const Triangle& triangle : mesh.triangles) {
        Vec3 point[3], edge[3], hat[3];
        for (int i = 0; i < 3; ++i) point[i] = mesh.positions[triangle.corner[i]];
        // edge[i] lies opposite corner i; the hat function of corner i rises from it towards the corner.
        for (int i = 0; i < 3; ++i) edge[i] = point[(i + 2) % 3] - point[(i + 1) % 3];
        const Vec3 normal = cross(edge[0], edge[1]);
        const float doubled_area = length(normal);
        if (doubled_area == 0.0f) continue;
        for (int i = 0; i < 3; ++i) hat[i] = cross(normal, edge[i]) * (1.0f / (doubled_area * doubled_area));
        for (int i = 0; i < 3; ++i) {
            const std::int32_t vertex = triangle.corner[i];
            const Vec3 to_next = edge[(i + 2) % 3], to_last = edge[(i + 1) % 3] * -1.0f;
            const float angle = std::atan2(doubled_area, dot(to_next, to_last));
            const float share = angle * doubled_area;
            for (int slot = 0; slot < kSlots; ++slot) {
                const std::int32_t joint = mesh.influences[vertex].joint[slot];
                float value[3];
                for (int k = 0; k < 3; ++k) value[k] = mesh.weight(triangle.corner[k], joint);
                if (value[0] == value[1] && value[1] == value[2]) continue;
                const Vec3 gradient = hat[0] * value[0] + hat[1] * value[1] + hat[2] * value[2];
                gradients[vertex].of[slot] = gradients[vertex].of[slot] + gradient * share;
                totals[vertex].of[slot] += share;
            }
        }
    }
    for (std::size_t vertex = 0; vertex < gradients.size(); ++vertex) {
        for (int slot = 0; slot < kSlots; ++slot) {
            const float total = totals[vertex].of[slot];
            if (total > 0.0f) gradients[vertex].of[slot] = gradients[vertex].of[slot] * (1.0f / total);
        }
    }
    return gradients;
}

template <typename Item>
void read_into(std::ifstream& file, std::vector<Item>& items, std::size_t count) {
    items.resize(count);
    file.read(reinterpret_cast<char*>(items.data()), static_cast<std::streamsize>(count * sizeof(Item)));
}

Mesh read_mesh(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    std::vector<std::int64_t> counts;
    Mesh mesh;
    read_into(file, counts, 2);
    if (!file) throw std::runtime_error(path + " cannot be read");
    read_into(file, mesh.positions, counts[0]);
    read_into(file, mesh.triangles, counts[1]);
    read_into(file, mesh.influences, counts[0]);
    read_into(file, mesh.weights, counts[0]);
    if (!file) throw std::runtime_error(path + " is too short");
    return mesh;
}

}  // namespace

int main(int count, char** arguments) {
    if (count < 3) {
        std::fprintf(stderr, "usage: %s MESH REPEATS [GRADIENTS]\n", arguments[0]);
        return 2;
    }
    try {
        const Mesh mesh = read_mesh(arguments[1]);
        std::vector<SlotGradients> gradients;
        for (int repeat = std::atoi(arguments[2]); repeat > 0; --repeat) {
            const auto start = std::chrono::steady_clock::now();
            gradients = weight_gradients(mesh);
            const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - start;
            std::printf("%.6f\n", taken.count());
        }
        if (count > 3) {
            std::ofstream file(arguments[3], std::ios::binary);
            file.write(reinterpret_cast<const char*>(gradients.data()),
                       static_cast<std::streamsize>(gradients.size() * sizeof(SlotGradients)));
            if (!file) throw std::runtime_error(std::string(arguments[3]) + " cannot be written");
        }
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}
