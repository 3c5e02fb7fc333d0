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
  // Tracklets have hues between red and blue, which no other layer uses.
  const hues = ["#e05cc0", "#b08cff", "#ff8fd8", "#8f6bff", "#d8a0ff", "#c23bd1"];
  const MAX_ZOOM = Math.max(12, 4 * Math.ceil(Math.max(data.rows, data.cols) / 1024));

  const viewer = byId("viewer");
  if (viewer && data.layers.length) {
    const stage = byId("stage"), overlay = byId("overlay"), picture = byId("picture");
    const layers = { truth: true, rois: false, stars: false, streaks: true, tracklets: false };
    const view = { at: 0, zoom: 1, x: 0, y: 0 };
    let timer = null, pixels = null;
    byId("zoom").max = MAX_ZOOM;
    overlay.setAttribute("viewBox", `0 0 ${data.cols} ${data.rows}`);
    stage.style.aspectRatio = `${data.cols} / ${data.rows}`;

    const draw = () => {
      const frame = data.layers[view.at];
      picture.src = data.previews[frame.frame];
      byId("which").textContent = `frame ${frame.frame} (${view.at + 1} of ${data.layers.length})`;
      byId("state").textContent = frame.state;
      pixels = null;
      overlay.replaceChildren();
      close();
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
    // Close up, full-resolution tiles lie over the preview where there is something to see.
    const sharp = document.createElement("div");
    sharp.id = "sharp";
    stage.insertBefore(sharp, overlay);
    const close = () => {
      const frame = data.layers[view.at], tiles = data.tiles[frame.frame] ?? [];
      const wanted = view.zoom >= 2 ? frame.frame : -1;
      if (Number(sharp.dataset.frame) === wanted) return;
      sharp.dataset.frame = wanted;
      sharp.replaceChildren(...(wanted < 0 ? [] : tiles.map(([row, col, uri]) => {
        const tile = document.createElement("img");
        tile.src = uri;
        tile.alt = "";
        tile.style.cssText = `left:${100 * col / data.cols}%;top:${100 * row / data.rows}%;` +
          `width:${100 * Math.min(data.tile, data.cols - col) / data.cols}%;height:${100 * Math.min(data.tile, data.rows - row) / data.rows}%`;
        return tile;
      })));
    };
    // Row, col, direction and brightness under the pointer; brightness by turning the shown grey back into ADU.
    const grey = (image, x, y) => {
      const canvas = document.createElement("canvas");
      canvas.width = image.naturalWidth;
      canvas.height = image.naturalHeight;
      const context = canvas.getContext("2d", { willReadFrequently: true });
      context.drawImage(image, 0, 0);
      return context.getImageData(Math.floor(x), Math.floor(y), 1, 1).data[0];
    };
    const adu = (value, [black, soft, top]) => black + soft * Math.sinh(value / 255 * top);
    const direction = (sky, row, col) => {
      const side = Math.sqrt(sky[0].length);
      const y = Math.min(side - 1, Math.max(0, row / (data.rows - 1) * (side - 1)));
      const x = Math.min(side - 1, Math.max(0, col / (data.cols - 1) * (side - 1)));
      const i = Math.min(side - 2, Math.floor(y)), j = Math.min(side - 2, Math.floor(x));
      const sum = [0, 0, 0];
      for (const [di, dj] of [[0, 0], [0, 1], [1, 0], [1, 1]]) {
        const weight = (di ? y - i : 1 - y + i) * (dj ? x - j : 1 - x + j), k = (i + di) * side + j + dj;
        const [a, d] = [sky[0][k], sky[1][k]].map((v) => v * Math.PI / 180);
        sum[0] += weight * Math.cos(d) * Math.cos(a);
        sum[1] += weight * Math.cos(d) * Math.sin(a);
        sum[2] += weight * Math.sin(d);
      }
      const turn = Math.atan2(sum[1], sum[0]) * 180 / Math.PI;
      return [(turn + 360) % 360, Math.atan2(sum[2], Math.hypot(sum[0], sum[1])) * 180 / Math.PI];
    };
    const tell = (e) => {
      const box = stage.getBoundingClientRect();
      const col = (e.clientX - box.left) / box.width * data.cols - 0.5, row = (e.clientY - box.top) / box.height * data.rows - 0.5;
      const inside = col >= -0.5 && row >= -0.5 && col < data.cols - 0.5 && row < data.rows - 0.5;
      if (!inside) { byId("pointer").textContent = ""; return; }
      const frame = data.layers[view.at], stretches = data.stretches[frame.frame];
      const words = [`row ${row.toFixed(1)}, col ${col.toFixed(1)}`];
      if (frame.sky) {
        const [ra, dec] = direction(frame.sky, row, col);
        words.push(`RA ${ra.toFixed(4)}, Dec ${dec.toFixed(4)} deg (apparent)`);
      }
      const tile = (data.tiles[frame.frame] ?? []).findIndex(([r, c]) => row + 0.5 >= r && row + 0.5 < r + data.tile && col + 0.5 >= c && col + 0.5 < c + data.tile);
      const shown = tile >= 0 ? sharp.children[tile] : undefined;
      if (shown && shown.complete && shown.naturalWidth) {
        const [r, c] = data.tiles[frame.frame][tile];
        words.push(`${adu(grey(shown, col + 0.5 - c, row + 0.5 - r), stretches.tiles).toFixed(0)} ADU`);
      } else if (picture.complete && picture.naturalWidth) {
        const scale = picture.naturalWidth / data.cols, n = Math.round(1 / scale);
        if (!pixels) {
          const canvas = document.createElement("canvas");
          canvas.width = picture.naturalWidth;
          canvas.height = picture.naturalHeight;
          pixels = canvas.getContext("2d", { willReadFrequently: true });
          pixels.drawImage(picture, 0, 0);
        }
        const value = pixels.getImageData(Math.floor((col + 0.5) * scale), Math.floor((row + 0.5) * scale), 1, 1).data[0];
        words.push(`${adu(value, stretches.preview).toFixed(0)} ADU${n > 1 ? `, mean of ${n} x ${n} px` : ""}`);
      }
      byId("pointer").textContent = words.join(" · ");
    };
    const stop = () => {
      clearInterval(timer);
      timer = null;
      for (const name of ["play", "blink"]) byId(name).setAttribute("aria-pressed", "false");
    };
    const repeat = (name, action, ms) => {
      const on = byId(name).getAttribute("aria-pressed") === "true";
      stop();
      if (on) return;
      byId(name).setAttribute("aria-pressed", "true");
      timer = setInterval(action, ms);
    };
    const play = () => repeat("play", () => step(1), 400);
    const blink = () => { let back = false; repeat("blink", () => { back = !back; step(back ? 1 : -1); }, 500); };
    const place = () => {
      const box = viewer.getBoundingClientRect();
      const spare = (side) => Math.min(0, side - side * view.zoom);
      view.x = Math.min(0, Math.max(spare(box.width), view.x));
      view.y = Math.min(0, Math.max(spare(box.height), view.y));
      stage.style.transform = `translate(${view.x}px, ${view.y}px) scale(${view.zoom})`;
      byId("zoom").value = view.zoom;
      close();
    };
    const zoomTo = (zoom, x, y) => {
      const next = Math.min(MAX_ZOOM, Math.max(1, zoom));
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

    byId("previous").onclick = () => { stop(); step(-1); };
    byId("next").onclick = () => { stop(); step(1); };
    byId("play").onclick = play;
    byId("blink").onclick = blink;
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
    viewer.addEventListener("pointermove", (e) => { tell(e); if (held) { view.x = e.clientX - held[0]; view.y = e.clientY - held[1]; place(); } });
    viewer.addEventListener("pointerup", () => { held = null; });
    const keys = { t: "truth", r: "rois", s: "stars", m: "streaks", k: "tracklets" };
    document.addEventListener("keydown", (e) => {
      if (e.target.tagName === "INPUT" && e.target.type === "range" || byId("case").open || e.ctrlKey || e.metaKey || e.altKey) return;
      if (e.key === "ArrowLeft") { stop(); step(-1); }
      else if (e.key === "ArrowRight") { stop(); step(1); }
      else if (e.key === "p") play();
      else if (e.key === "b") blink();
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
