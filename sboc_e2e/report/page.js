"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  const svgNs = "http://www.w3.org/2000/svg";
  const make = (name, attributes) => {
    const node = document.createElementNS(svgNs, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    return node;
  };
  // Centres of pixels are integers: the first pixel's edge lies at -0.5.
  const points = (line) => line.map(([c, r]) => `${c + 0.5},${r + 0.5}`).join(" ");
  const hues = ["#4aa8ff", "#ff9d2e", "#39c36a", "#e05cc0", "#b9a1ff", "#3fd0d0", "#e8d24a", "#ff7b6b"];

  const viewer = byId("viewer");
  if (viewer && data.layers.length) {
    const stage = byId("stage"), overlay = byId("overlay"), picture = byId("picture");
    const layers = { truth: true, rois: false, stars: false, streaks: true, tracklets: false };
    const view = { at: 0, zoom: 1, x: 0, y: 0 };
    overlay.setAttribute("viewBox", `0 0 ${data.cols} ${data.rows}`);
    stage.style.aspectRatio = `${data.cols} / ${data.rows}`;

    const draw = () => {
      const frame = data.layers[view.at];
      picture.src = data.previews[frame.frame];
      byId("which").textContent = `frame ${frame.frame} (${view.at + 1} of ${data.layers.length})`;
      overlay.replaceChildren();
      const add = (node, title) => {
        if (title) { const t = make("title", {}); t.textContent = title; node.append(t); }
        overlay.append(node);
      };
      if (layers.stars) for (const [c, r] of frame.stars)
        add(make("circle", { cx: c + 0.5, cy: r + 0.5, r: data.cols / 250, class: "star" }));
      if (layers.rois) for (const group of frame.rois) for (const outline of group)
        add(make("polygon", { points: points(outline), class: "roi" }));
      if (layers.truth) for (const t of frame.truth)
        add(make("polyline", { points: points(t.line), class: t.found ? "truth-found" : "truth-missed" }),
          `object ${t.object}, S/N ${t.snr ?? "unknown"}`);
      if (layers.streaks) for (const s of frame.streaks)
        add(make("polyline", { points: points(s.line), class: s.vetoed ? "vetoed" : s.true ? "measured" : "false-alarm" }),
          `streak ${s.id}, S/N ${s.snr}`);
      if (layers.tracklets) for (const each of data.layers) for (const s of each.streaks)
        if (s.tracklet >= 0) {
          const node = make("polyline", { points: points(s.line) });
          node.style.stroke = hues[s.tracklet % hues.length];
          add(node, `tracklet ${s.tracklet}, frame ${each.frame}`);
        }
    };
    const place = () => {
      const box = viewer.getBoundingClientRect();
      const spare = (side) => Math.min(0, side - side * view.zoom);
      view.x = Math.min(0, Math.max(spare(box.width), view.x));
      view.y = Math.min(0, Math.max(spare(box.height), view.y));
      stage.style.transform = `translate(${view.x}px, ${view.y}px) scale(${view.zoom})`;
      byId("zoom").value = view.zoom;
    };
    const zoomTo = (zoom, x, y) => {
      const next = Math.min(12, Math.max(1, zoom));
      view.x = x - (x - view.x) * next / view.zoom;
      view.y = y - (y - view.y) * next / view.zoom;
      view.zoom = next;
      place();
    };
    const middle = () => { const b = viewer.getBoundingClientRect(); return [b.width / 2, b.height / 2]; };
    const step = (by) => { view.at = (view.at + by + data.layers.length) % data.layers.length; draw(); };
    const toggle = (name, on) => {
      layers[name] = on;
      document.querySelector(`[data-layer="${name}"]`).checked = on;
      draw();
    };
    const tone = () => { picture.style.filter = `brightness(${byId("stretch").value}) contrast(${byId("black").value})`; };

    byId("previous").onclick = () => step(-1);
    byId("next").onclick = () => step(1);
    byId("zoom").oninput = (e) => zoomTo(Number(e.target.value), ...middle());
    byId("stretch").oninput = tone;
    byId("black").oninput = tone;
    for (const box of document.querySelectorAll("[data-layer]")) box.onchange = () => toggle(box.dataset.layer, box.checked);
    viewer.addEventListener("wheel", (e) => {
      e.preventDefault();
      const b = viewer.getBoundingClientRect();
      zoomTo(view.zoom * Math.exp(-e.deltaY / 400), e.clientX - b.left, e.clientY - b.top);
    }, { passive: false });
    let held = null;
    viewer.addEventListener("pointerdown", (e) => { held = [e.clientX - view.x, e.clientY - view.y]; viewer.setPointerCapture(e.pointerId); });
    viewer.addEventListener("pointermove", (e) => { if (held) { view.x = e.clientX - held[0]; view.y = e.clientY - held[1]; place(); } });
    viewer.addEventListener("pointerup", () => { held = null; });
    const keys = { t: "truth", r: "rois", s: "stars", m: "streaks", k: "tracklets" };
    document.addEventListener("keydown", (e) => {
      if (e.target.tagName === "INPUT" && e.target.type === "range" || byId("case").open || e.ctrlKey || e.metaKey || e.altKey) return;
      if (e.key === "ArrowLeft") step(-1);
      else if (e.key === "ArrowRight") step(1);
      else if (e.key === "+" || e.key === "=") zoomTo(view.zoom * 1.25, ...middle());
      else if (e.key === "-") zoomTo(view.zoom / 1.25, ...middle());
      else if (keys[e.key]) toggle(keys[e.key], !layers[keys[e.key]]);
      else return;
      e.preventDefault();
    });
    draw();
    place();
  }

  const dialog = byId("case");
  byId("close").onclick = () => dialog.close();
  const open = (item) => {
    byId("case-title").textContent = `${item.what}, frame ${item.frame}`;
    const body = byId("case-body");
    body.replaceChildren();
    if (item.picture) {
      const shot = document.createElement("div");
      shot.className = "shot";
      const image = document.createElement("img");
      image.src = item.picture;
      image.alt = "cut-out";
      const over = make("svg", { viewBox: `0 0 ${data.cutout} ${data.cutout}` });
      over.append(make("polyline", { points: item.line.map(([c, r]) => `${c - item.col0 + 0.5},${r - item.row0 + 0.5}`).join(" ") }));
      shot.append(image, over);
      body.append(shot);
    }
    const words = document.createElement("p");
    words.textContent = `S/N ${item.snr ?? "unknown"}, length ${item.length} px, at row ${item.row.toFixed(1)}, col ${item.col.toFixed(1)}. ${item.reason}.`;
    body.append(words);
    dialog.showModal();
  };
  for (const list of document.querySelectorAll("[data-cases]")) for (const item of data.cases[list.dataset.cases]) {
    const button = document.createElement("button");
    button.className = "case";
    if (item.picture) {
      const image = document.createElement("img");
      image.src = item.picture;
      image.alt = "";
      button.append(image);
    }
    button.append(`S/N ${item.snr ?? "unknown"}, ${item.length} px, frame ${item.frame}`);
    button.onclick = () => open(item);
    list.append(button);
  }
})();
