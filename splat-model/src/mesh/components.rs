//! Connected components of a mesh.

use super::surface::Extracted;

/// The root of a vertex in a forest in which `parents` names the parent of each. Halves the path.
fn root(parents: &mut [u32], mut at: u32) -> u32 {
    while parents[at as usize] != at {
        parents[at as usize] = parents[parents[at as usize] as usize];
        at = parents[at as usize];
    }
    at
}

/// Keeps the components of at least `min` triangles that views have seen, and the vertices that they use, in their order. Of a component
/// that views have seen a tenth of the vertices are not next to unseen voxels. Returns the number of components before.
pub(super) fn keep_large(mesh: &mut Extracted, min: usize) -> usize {
    let count = mesh.vertices.len();
    let mut parents: Vec<u32> = (0..count as u32).collect();
    for [a, b, c] in &mesh.triangles {
        for other in [b, c] {
            let (one, other) = (root(&mut parents, *a), root(&mut parents, *other));
            // The smaller number is the root, so that the order of triangles does not matter.
            parents[one.max(other) as usize] = one.min(other);
        }
    }
    let roots: Vec<usize> = (0..count as u32).map(|vertex| root(&mut parents, vertex) as usize).collect();
    let (mut triangles, mut vertices) = (vec![0; count], vec![[0_usize; 2]; count]);
    mesh.triangles.iter().for_each(|triangle| triangles[roots[triangle[0] as usize]] += 1);
    for (vertex, &root) in mesh.vertices.iter().zip(&roots) {
        vertices[root][0] += 1;
        vertices[root][1] += usize::from(vertex.is_seen);
    }
    let stays = |vertex: usize| {
        let [all, seen] = vertices[roots[vertex]];
        triangles[roots[vertex]] >= min.max(1) && 10 * seen >= all
    };
    let (mut place, mut kept) = (vec![0; count], 0);
    for vertex in 0..count {
        place[vertex] = kept;
        kept += u32::from(stays(vertex));
    }
    mesh.triangles.retain(|triangle| stays(triangle[0] as usize));
    mesh.triangles.iter_mut().flatten().for_each(|vertex| *vertex = place[*vertex as usize]);
    let mut vertices = 0..count;
    mesh.vertices.retain(|_| vertices.next().is_some_and(stays));
    triangles.iter().filter(|&&triangles| triangles > 0).count()
}
