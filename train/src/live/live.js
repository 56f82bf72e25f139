// Shows a run while it trains (see shared.rs): asks for its numbers every second, and loads the scene when there is a new one.
// The document's element has `data-live="training"`, "done" after the run, or "gone" when the server does not answer.
"use strict";
(() => {
  const root = document.documentElement;
  const at = (id) => document.getElementById(id);
  const say = (id, text) => { at(id).textContent = text; };
  const clock = (seconds) => {
    const whole = Math.round(seconds), pad = (value) => String(value).padStart(2, "0");
    const [h, m, s] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
    return h > 0 ? `${h}:${pad(m)}:${pad(s)}` : `${m}:${pad(s)}`;
  };
  // A request may fail once on its way; so many in a row mean that the run has ended.
  const FAILURES = 4;
  let scene = null, worst = null, points = -1, failures = 0;

  const showWorst = async (state) => {
    if (!state.worst || state.worst.step === worst) return;
    const answer = await fetch("worst.jpg");
    if (!answer.ok) return;
    worst = state.worst.step;
    const picture = at("live-worst-picture");
    URL.revokeObjectURL(picture.src);
    picture.src = URL.createObjectURL(await answer.blob());
    say("live-worst-name", `${state.worst.name}: ${state.worst.psnr.toFixed(2)} dB after step ${state.worst.step}`);
    at("live-worst").hidden = false;
  };

  const show = (state) => {
    const { history, metrics } = state;
    say("live-step", metrics ? String(metrics.steps) : `${state.step} / ${state.steps}`);
    say("live-left", clock(state.left_s));
    say("live-seconds", clock(state.seconds));
    say("live-splats", String(state.splats));
    const loss = history.points.at(-1)?.loss;
    say("live-loss", typeof loss === "number" ? loss.toFixed(4) : "–");
    const psnr = metrics ? metrics.test?.psnr : history.scores.at(-1)?.psnr;
    say("live-psnr", typeof psnr === "number" ? `${psnr.toFixed(2)} dB` : "–");
    if (history.points.length + history.scores.length !== points) {
      points = history.points.length + history.scores.length;
      splatCurves(history, metrics?.test ? [metrics.test.psnr, metrics.test.views.length] : null);
    }
    if (state.scene !== scene) {
      scene = state.scene;
      dispatchEvent(new CustomEvent("splat-scene", { detail: `scene.ply?step=${scene}` }));
    }
  };

  at("live-stop").onclick = async () => {
    at("live-stop").disabled = true;
    say("live-note", "The run stops after this step and writes its results.");
    const ask = () => fetch("stop", { method: "POST" });
    await ask().catch(ask).catch(gone);
  };

  const gone = () => {
    root.dataset.live = "gone";
    at("live-stop").disabled = true;
    say("live-note", "The run does not answer: it has ended.");
  };

  const tick = async () => {
    let state = null;
    try {
      state = await (await fetch("status.json")).json();
      // The numbers are shown even where the picture fails to arrive.
      if (state !== null) await showWorst(state).catch(() => {});
      failures = 0;
    } catch {
      failures += 1;
      if (failures === FAILURES) return gone();
      setTimeout(tick, 1000);
      return;
    }
    if (state !== null) {
      show(state);
      if (state.metrics) {
        root.dataset.live = "done";
        at("live-stop").disabled = true;
        say("live-note", "The run is done. report.html in its folder has all results.");
        return;
      }
      root.dataset.live = "training";
    }
    setTimeout(tick, 1000);
  };
  tick();
})();
