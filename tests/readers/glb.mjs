// Opens a .glb with three.js and with Khronos' validator, and writes what they find as JSON: `node glb.mjs FILE`.
// `rows` has the centre, scale, rotation (x y z w), opacity and coefficients of every Gaussian as three.js' GLTFLoader has them; `splats` is
// the number that three.js' own extension for Gaussians accepts; `triangles` is the number of those of a mesh; `problems` are the validator's
// errors.
import { readFileSync } from "node:fs";
import validator from "gltf-validator";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

const bytes = new Uint8Array(readFileSync(process.argv[2]));
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const parse = (loader) => new Promise((found, failed) => loader.parse(buffer, "", found, failed));

const plain = await parse(new GLTFLoader());
const points = [];
let triangles = 0;
plain.scene.traverse((object) => {
  if (object.isPoints) points.push(object);
  if (object.isMesh) triangles += object.geometry.index.count / 3;
});
const name = (text) => `khr_gaussian_splatting:${text}`;
const rows = points.flatMap(({ geometry: { attributes } }) => {
  const coefficients = Object.keys(attributes).filter((key) => key.startsWith(name("sh_degree_")));
  const order = [attributes.position, ...["scale", "rotation", "opacity"].map((text) => attributes[name(text)])];
  order.push(...coefficients.sort().map((key) => attributes[key]));
  return Array.from({ length: attributes.position.count }, (_, i) =>
    order.flatMap((attribute) => Array.from({ length: attribute.itemSize }, (_, c) => attribute.getComponent(i, c))));
});

let splats = null;
try {
  // The extension needs no device to read.
  const { GLTFGaussianSplatLoaderExtension } = await import("three/addons/loaders/GLTFGaussianSplatLoaderExtension.js");
  const loader = new GLTFLoader();
  loader.register((parser) => new GLTFGaussianSplatLoaderExtension(parser));
  const scene = await parse(loader);
  scene.scene.traverse((object) => { if (object.isGaussianSplat) splats = (splats ?? 0) + object.geometry.instanceCount; });
} catch (error) {
  splats = String(error);
}
const report = await validator.validateBytes(bytes, { maxIssues: 1000 });
// The validator is older than the extension, whose attributes it does not know.
const unknown = (issue) => issue.code === "MESH_PRIMITIVE_INVALID_ATTRIBUTE" && issue.pointer.includes("/KHR_gaussian_splatting:");
const problems = report.issues.messages.filter((issue) => issue.severity === 0 && !unknown(issue));
console.log(JSON.stringify({ rows, splats, triangles, problems }));
