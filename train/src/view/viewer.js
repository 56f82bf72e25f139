// Draws a scene of Gaussians in the element #viewer, with the libraries of assets/viewer/library.js. The settings are
// in #viewer-setup (see page.rs). After the first complete frame, the document's element has `data-viewer="drawn"`;
// after a failure it has `data-viewer="failed"`, and the reason is written in place of the picture.
"use strict";
(async () => {
  const root = document.documentElement;
  const holder = document.getElementById("viewer");
  const note = document.getElementById("viewer-note");
  const setup = JSON.parse(document.getElementById("viewer-setup").textContent);
  try {
    const { PerspectiveCamera, Scene, Vector3, WebGLRenderer, OrbitControls, SparkRenderer, SplatMesh } = SplatLibrary;
    const renderer = new WebGLRenderer({ antialias: false });
    renderer.setClearColor(`rgb(${setup.background.map((value) => Math.round(255 * value)).join()})`);
    renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    const scene = new Scene();
    const camera = new PerspectiveCamera(50, 1, 1e-3 * setup.radius, 1e4 * setup.radius);
    // Set before the controls are made, which turn around this axis from then on.
    camera.up.set(...setup.up);
    const controls = new OrbitControls(camera, renderer.domElement);
    let dirty = true;
    // The trainer's settings: the same blur, with or without compensation, and splats in the order of their centres'
    // depths.
    const spark = new SparkRenderer({
      renderer,
      sortRadial: false,
      preBlurAmount: setup.antialias ? 0 : setup.blur,
      blurAmount: setup.antialias ? setup.blur : 0,
      onDirty: () => { dirty = true; },
    });
    scene.add(spark);
    holder.prepend(renderer.domElement);

    const resize = () => {
      const { clientWidth: width, clientHeight: height } = holder;
      if (width === 0 || height === 0) return;
      renderer.setSize(width, height);
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
      dirty = true;
    };
    new ResizeObserver(resize).observe(holder);
    resize();

    // Cameras of the trainer's files look along +z with +y down; those of three.js along -z with +y up.
    const centre = new Vector3(...setup.centre);
    const aim = ({ position: [...at], forward, fov_y_degrees: fov }) => {
      const position = new Vector3(...at), ahead = new Vector3(...forward);
      const depth = centre.clone().sub(position).dot(ahead);
      const distance = depth > 0.05 * setup.radius ? depth : setup.radius;
      return { position, target: position.clone().addScaledVector(ahead, distance), fov };
    };
    const stand = ({ position, target, fov }) => {
      camera.position.copy(position);
      camera.fov = fov;
      camera.updateProjectionMatrix();
      controls.target.copy(target);
      controls.update();
      dirty = true;
    };
    const look = (viewpoint) => stand(aim(viewpoint));
    look(setup.cameras[0]);
    const select = document.getElementById("viewer-camera");
    if (select) select.onchange = () => look(setup.cameras[Number(select.value)]);

    // A button's flight takes a second, slow at both ends. The document's element names the view that it arrived at.
    let flight = null;
    const fly = (view) => {
      const from = { position: camera.position.clone(), target: controls.target.clone(), fov: camera.fov };
      const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
      flight = { from, to: aim(setup.cameras[view]), view, start: performance.now(), duration: still ? 0 : 1000 };
      delete root.dataset.view;
    };
    const onward = () => {
      const { from, to, view, start, duration } = flight;
      const share = duration > 0 ? Math.min((performance.now() - start) / duration, 1) : 1;
      const eased = share * share * (3 - 2 * share);
      stand({
        position: from.position.clone().lerp(to.position, eased),
        target: from.target.clone().lerp(to.target, eased),
        fov: from.fov + (to.fov - from.fov) * eased,
      });
      if (share < 1) return;
      flight = null;
      root.dataset.view = view;
    };
    document.querySelectorAll("#viewer-views button").forEach((button, view) => { button.onclick = () => fly(view); });
    renderer.domElement.addEventListener("pointerdown", () => { flight = null; });

    // A camera path, as `splat render --path` and nerfstudio read it: poses by rows with OpenGL's axes, in the world of the scene's file.
    if (setup.origin) {
      const bar = Object.assign(document.createElement("div"), { id: "viewer-bar" });
      const button = (textContent, title) => Object.assign(document.createElement("button"), { textContent, title });
      const add = button("add keyframe", "adds this view to a camera path");
      const remove = button("remove last", "removes the keyframe that was added last");
      const save = button("", "saves the path for splat render --path");
      bar.append(add, " ", remove, " ", save);
      holder.append(bar);
      const path = [];
      const show = () => {
        [remove.disabled, save.disabled] = [path.length < 1, path.length < 2];
        save.textContent = `save path of ${path.length}`;
      };
      show();
      add.onclick = () => {
        camera.updateMatrixWorld();
        const camera_to_world = camera.matrixWorld.clone().transpose().elements;
        setup.origin.forEach((value, axis) => { camera_to_world[4 * axis + 3] += value; });
        path.push({ camera_to_world, fov: camera.fov, aspect: camera.aspect });
        show();
      };
      remove.onclick = () => { path.pop(); show(); };
      save.onclick = () => {
        const text = JSON.stringify({ camera_type: "perspective", camera_path: path });
        const link = Object.assign(document.createElement("a"), { download: "camera_path.json" });
        link.href = `data:application/json,${encodeURIComponent(text)}`;
        link.click();
      };
    }

    // A page that scrolls keeps its wheel until the picture is clicked.
    if (setup.wheel_after_click) {
      controls.enableZoom = false;
      holder.addEventListener("pointerdown", () => { controls.enableZoom = true; });
      holder.addEventListener("pointerleave", () => { controls.enableZoom = false; });
    }
    controls.addEventListener("change", () => { dirty = true; });

    const bytes = setup.url === null ? inlined() : await fetched(setup.url);
    let mesh = null;
    // Shows a scene in place of the one before. The camera stays.
    const replace = async (bytes) => {
      const next = new SplatMesh({ fileBytes: bytes, fileType: setup.kind });
      await next.initialized;
      if (mesh) {
        scene.remove(mesh);
        mesh.dispose();
      }
      mesh = next;
      scene.add(mesh);
      dirty = true;
    };
    await replace(bytes);
    // A page whose scene changes names each new one; one that cannot be had leaves the one before.
    addEventListener("splat-scene", async ({ detail: url }) => {
      try {
        await replace(await fetched(url));
        root.dataset.scene = url;
      } catch {
        // The run has ended.
      }
    });

    let visible = true;
    new IntersectionObserver((entries) => { visible = entries[entries.length - 1].isIntersecting; }).observe(holder);
    // Number of frames after which the picture is certainly complete.
    const SURE = 3;
    let drawn = 0;
    renderer.setAnimationLoop(() => {
      if (flight) onward();
      if (!visible || !(dirty || drawn < SURE)) return;
      dirty = false;
      controls.update();
      renderer.render(scene, camera);
      // Splats are sorted in parallel with the drawing, so the first frames show none.
      drawn = spark.activeSplats > 0 ? drawn + 1 : 0;
      if (drawn === SURE) root.dataset.viewer = "drawn";
    });
  } catch (error) {
    root.dataset.viewer = "failed";
    note.textContent = `The scene cannot be drawn here: ${error.message ?? error}. A browser with WebGL 2 is needed.`;
  }

  function inlined() {
    const text = atob(document.getElementById("viewer-scene").textContent);
    return Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  }

  async function fetched(url) {
    const answer = await fetch(url);
    if (!answer.ok) throw new Error(`${url}: ${answer.status} ${answer.statusText}`);
    return new Uint8Array(await answer.arrayBuffer());
  }
})();
