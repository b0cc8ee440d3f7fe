#include "vmslam/online/graph.hpp"

#include <algorithm>
#include <cmath>

namespace vmslam::online {
namespace {

/// Node j where the edge from node i says.
void place_second(const NewEdge& edge, const Node& i, Node& j) {
    const auto [c, s] = i.axes;
    j.point = !edge.oriented;
    j.begin({i.x[0] + c * edge.z.x - s * edge.z.y, i.x[1] + s * edge.z.x + c * edge.z.y,
             edge.oriented ? i.x[2] + edge.z.t : 0.0});
}

/// Pose i so that the edge from it leads to pose j.
void place_first(const NewEdge& edge, Node& i, const Node& j) {
    const double heading = j.x[2] - edge.z.t;
    const auto [c, s] = Rotation(heading);
    i.point = false;
    i.begin({j.x[0] - c * edge.z.x + s * edge.z.y, j.x[1] - s * edge.z.x - c * edge.z.y, heading});
}

/// The standard deviations of the nodes of a new edge. A pose without sightings takes those of the pose before it.
void rescale(const Edge& edge, Node& i, Node& j) {
    const bool number = edge.single_number();
    double place_std = 1 / std::sqrt(number ? edge.omega.xx : std::min(edge.omega.xx, edge.omega.yy));
    double heading_std = edge.oriented ? 1 / std::sqrt(edge.omega.tt) : infinity;
    if (edge.kind == Kind::sighting) {
        heading_std = place_std / std::max(std::hypot(edge.z.x, edge.z.y), place_std);
        if (i.borrows) i.place_std = i.heading_std = infinity;
    }
    if (number) {
        const double away = std::hypot(j.x[0] - i.x[0], j.x[1] - i.x[1]);
        heading_std = edge.kind == Kind::bearing ? place_std : place_std / std::max(away, place_std);
        if (edge.kind == Kind::bearing) place_std *= away;
    }
    if (edge.kind == Kind::motion) {
        if (i.place_std == infinity) i.place_std = place_std, i.heading_std = heading_std;
        j.place_std = i.place_std, j.heading_std = i.heading_std, j.borrows = true;
        return;
    }
    for (Node* const node : {&i, &j}) {
        node->place_std = std::min(node->place_std, place_std);
        node->heading_std = std::min(node->heading_std, heading_std);
        node->borrows = false;
    }
}

}  // namespace

std::vector<Id> Graph::append(std::span<const NewEdge> added, Id known) {
    std::vector<Id> touched;
    Id place = known;
    for (const NewEdge& from : added) {
        const auto number = static_cast<Id>(edges.size());
        Edge& edge = edges.emplace_back(Edge{from});
        has_single_numbers = has_single_numbers || edge.single_number();
        edge.robust = kernel_of(edge) && (edge.robust || edge.seen());
        for (int side = 0; side < (edge.one_ended() ? 1 : 2); ++side) {
            const Id end = edge.ends[side];
            Node& node = nodes[end];
            edge.next[side] = node.edges;
            node.edges = number;
            if (node.local >= 0) continue;
            node.local = 0;
            touched.push_back(end);
        }
        const auto& [first, second] = edge.ends;
        Node &i = nodes[first], &j = nodes[second];
        if (second >= place) {
            if (edge.relative()) place_second(edge, i, j);
            place = second + 1;
        } else if (first >= place) {
            place_first(edge, i, j);
            place = first + 1;
        }
        rescale(edge, i, j);
    }
    for (const Id node : touched) nodes[node].local = -1;
    return touched;
}

void Graph::detach(Id first) {
    for (auto e = static_cast<Id>(edges.size()) - 1; e >= first; --e) {
        const Edge& edge = edges[e];
        for (int side = edge.one_ended() ? 0 : 1; side >= 0; --side) nodes[edge.ends[side]].edges = edge.next[side];
    }
    edges.resize(first);
}

void Graph::unlink(Id edge, Id node) {
    const Id after = edges[edge].next[edges[edge].side(node)];
    Id* at = &nodes[node].edges;
    while (*at != edge) at = &edges[*at].next[edges[*at].side(node)];
    *at = after;
}

std::vector<Triple> Graph::values(std::span<const Id> of) const {
    std::vector<Triple> x;
    for (const Id node : of) x.push_back(nodes[node].x);
    return x;
}

std::vector<Id> Graph::edges_of(Id node) const {
    std::vector<Id> found;
    for (Id e = nodes[node].edges; e >= 0; e = edges[e].next[edges[e].side(node)]) found.push_back(e);
    return found;
}

std::vector<Id> Graph::live_nodes() const {
    std::vector<Id> found;
    for (Id k = 0; k < size(); ++k)
        if (!nodes[k].gone) found.push_back(k);
    return found;
}

std::vector<Id> Graph::live_edges() const {
    std::vector<Id> found;
    for (std::size_t e = 0; e < edges.size(); ++e)
        if (!edges[e].taken_out()) found.push_back(static_cast<Id>(e));
    return found;
}

}  // namespace vmslam::online
