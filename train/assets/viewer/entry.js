// What the page's own script (src/view/viewer.js) uses of the libraries; the rest is left out of the bundle.
export { PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
