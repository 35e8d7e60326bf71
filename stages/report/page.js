(() => {
  const {luminance, srgb, byteOf} = pixels;
  const pictures = JSON.parse(document.getElementById("data").textContent).pictures.map(p =>
    ({name: p.name, width: p.width, height: p.height, rgb: pixels.decode(p.halves), drawn: {}}));
  const reference = pictures[pictures.length - 1], width = reference.width, height = reference.height;
  reference.name = "Reference";
  const byId = id => document.getElementById(id);
  const isCheck = location.hash === "#check", readable = {willReadFrequently: isCheck};

  // (x - r) / sqrt(r^2 + 0.01) of luminance.
  const errorAt = (picture, i) => {
    const r = luminance(reference.rgb, i);
    return (luminance(picture.rgb, i) - r) / Math.sqrt(r * r + 0.01);
  };
  // The 99th percentile of the first method's, in two digits: where colours end.
  const sizes = Float32Array.from({length: width * height}, (_, i) => Math.abs(errorAt(pictures[0], i))).filter(Number.isFinite).sort();
  const firstReach = sizes[Math.floor(0.99 * (sizes.length - 1))] || 1;

  const state = {left: pictures.length - 1, right: Math.max(0, pictures.length - 2), split: 0.5, exposure: 0, reach: firstReach, asError: false, zoom: 1, x: 0.5, y: 0.5};

  // Dark blue, light blue, no colour, orange, dark red; linear.
  const stops = [[0.005, 0.03, 0.22], [0.12, 0.38, 0.72], [1, 1, 1], [0.90, 0.29, 0.10], [0.24, 0.005, 0.015]];
  const errorColour = t => {
    if (Number.isNaN(t)) return [0, 0, 0];
    const at = 2 * Math.min(1, Math.max(-1, t)) + 2, k = Math.min(3, Math.floor(at)), f = at - k;
    return stops[k].map((low, c) => srgb[Math.round(4096 * ((1 - f) * low + f * stops[k + 1][c]))]);
  };

  // A picture as a canvas of its own size, kept until exposure or reach change.
  function drawnPicture(picture, asError) {
    const kind = asError ? "error" : "plain", key = asError ? state.reach : state.exposure, kept = picture.drawn[kind];
    if (kept && kept.key === key) return kept.canvas;
    const canvas = kept ? kept.canvas : document.createElement("canvas");
    canvas.width = width; canvas.height = height;
    const context = canvas.getContext("2d", readable), out = context.createImageData(width, height), scale = 2 ** state.exposure;
    for (let i = 0; i < width * height; ++i) {
      if (asError) {
        out.data.set(errorColour(errorAt(picture, i) / state.reach), 4 * i);
      } else {
        for (let c = 0; c < 3; ++c) out.data[4 * i + c] = byteOf(scale * picture.rgb[3 * i + c]);
      }
      out.data[4 * i + 3] = 255;
    }
    context.putImageData(out, 0, 0);
    picture.drawn[kind] = {key, canvas};
    return canvas;
  }

  // The part of a picture that all canvases show: its left upper corner and its size, in pixels of the picture.
  function shownPart() {
    const w = width / state.zoom, h = height / state.zoom;
    const left = Math.min(width - w, Math.max(0, state.x * width - w / 2)), top = Math.min(height - h, Math.max(0, state.y * height - h / 2));
    return {left, top, w, h};
  }
  function fit(canvas) {
    const css = canvas.parentElement.clientWidth, ratio = window.devicePixelRatio || 1, w = Math.max(1, Math.round(css * ratio)), h = Math.max(1, Math.round(w * height / width));
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const context = canvas.getContext("2d", readable);
    const part = shownPart();
    context.imageSmoothingEnabled = w < part.w;  // pixels stay pixels when enlarged
    return {context, w, h, part};
  }
  const put = (view, picture, asError) => view.context.drawImage(drawnPicture(picture, asError), view.part.left, view.part.top, view.part.w, view.part.h, 0, 0, view.w, view.h);

  const split = byId("split"), line = byId("line"), viewer = byId("viewer"), cells = [...document.querySelectorAll("canvas[data-picture]")];
  function drawSplit() {
    const view = fit(split), at = Math.round(state.split * view.w);
    put(view, pictures[state.left], state.asError);
    view.context.save();
    view.context.beginPath();
    view.context.rect(at, 0, view.w - at, view.h);
    view.context.clip();
    put(view, pictures[state.right], state.asError);
    view.context.restore();
    line.style.left = 100 * state.split + "%";
    line.setAttribute("aria-valuenow", Math.round(100 * state.split));
  }
  const shortNumber = v => v >= 100 ? v.toFixed(0) : v >= 0.1 ? v.toPrecision(2) : v.toPrecision(1);
  function draw() {
    const most = Math.min(viewer.parentElement.clientWidth, 0.82 * Math.max(420, window.innerHeight) * width / height);
    viewer.style.maxWidth = Math.round(most) + "px";
    drawSplit();
    for (const canvas of cells) put(fit(canvas), pictures[canvas.dataset.picture], "error" in canvas.dataset);
    byId("left-tag").textContent = pictures[state.left].name;
    byId("right-tag").textContent = pictures[state.right].name;
    byId("zoom").textContent = (state.zoom < 10 ? state.zoom.toFixed(1) : state.zoom.toFixed(0)) + "×";
    byId("exposure-value").textContent = (state.exposure < 0 ? "−" : "+") + Math.abs(state.exposure).toFixed(1) + " EV";
    byId("reach-value").textContent = "±" + shortNumber(state.reach);
    for (const end of document.querySelectorAll("[data-reach]")) end.textContent = (end.dataset.reach < 0 ? "−" : "+") + shortNumber(state.reach);
  }
  let pending = 0;
  const drawSoon = () => { pending = pending || requestAnimationFrame(() => { pending = 0; draw(); }); };

  function legend() {
    const canvas = byId("legend"), context = canvas.getContext("2d", readable);
    canvas.width = 257; canvas.height = 1;
    for (let i = 0; i < 257; ++i) {
      context.fillStyle = `rgb(${errorColour(i / 128 - 1).join()})`;
      context.fillRect(i, 0, 1, 1);
    }
  }

  // Controls.
  for (const side of ["left", "right"]) {
    const select = byId(side);
    pictures.forEach((p, k) => select.add(new Option(p.name, k, k === state[side], k === state[side])));
    select.addEventListener("change", () => { state[side] = Number(select.value); drawSoon(); });
  }
  byId("exposure").addEventListener("input", e => { state.exposure = Number(e.target.value); drawSoon(); });
  byId("exposure").addEventListener("dblclick", e => { e.target.value = state.exposure = 0; drawSoon(); });
  byId("reach").value = Math.log10(state.reach);
  byId("reach").addEventListener("input", e => { state.reach = 10 ** Number(e.target.value); drawSoon(); });
  byId("as-error").addEventListener("change", e => { state.asError = e.target.checked; drawSoon(); });
  function zoomTo(zoom, fx, fy) {
    // The point under the pointer stays where it is.
    const before = shownPart(), px = before.left + fx * before.w, py = before.top + fy * before.h;
    state.zoom = Math.min(64, Math.max(1, zoom));
    const w = width / state.zoom, h = height / state.zoom;
    state.x = Math.min(1, Math.max(0, (px - fx * w + w / 2) / width));
    state.y = Math.min(1, Math.max(0, (py - fy * h + h / 2) / height));
    drawSoon();
  }
  byId("in").addEventListener("click", () => zoomTo(state.zoom * 1.5, 0.5, 0.5));
  byId("out").addEventListener("click", () => zoomTo(state.zoom / 1.5, 0.5, 0.5));
  byId("whole").addEventListener("click", () => zoomTo(1, 0.5, 0.5));

  function moveLine(clientX) {
    const box = split.getBoundingClientRect();
    state.split = Math.min(1, Math.max(0, (clientX - box.left) / box.width));
    drawSplit();
  }
  line.addEventListener("pointerdown", e => { line.setPointerCapture(e.pointerId); e.preventDefault(); line.focus(); });
  line.addEventListener("pointermove", e => { if (line.hasPointerCapture(e.pointerId)) moveLine(e.clientX); });
  line.addEventListener("keydown", e => {
    const step = {ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1}[e.key];
    if (!step) return;
    e.preventDefault();
    state.split = Math.min(1, Math.max(0, state.split + step));
    drawSplit();
  });

  const digits = v => Number.isFinite(v) ? v.toPrecision(3) : String(v);
  function readOut(canvas, e) {
    const box = canvas.getBoundingClientRect(), part = shownPart();
    const x = Math.floor(part.left + (e.clientX - box.left) / box.width * part.w), y = Math.floor(part.top + (e.clientY - box.top) / box.height * part.h);
    if (x < 0 || y < 0 || x >= width || y >= height) return;
    const i = y * width + x, of = p => [0, 1, 2].map(c => digits(p.rgb[3 * i + c])).join(" ");
    const shown = canvas === split ? [pictures[state.left], pictures[state.right]] : [pictures[canvas.dataset.picture], reference];
    byId("readout").textContent = `pixel ${x}, ${y}   ` + [...new Set(shown)].map(p => `${p.name}: ${of(p)}` + (p === reference ? "" : ` (error ${digits(errorAt(p, i))})`)).join("   ");
  }
  for (const canvas of [split, ...cells]) {
    const fingers = new Map();
    let span = 0;
    canvas.addEventListener("pointerdown", e => { canvas.setPointerCapture(e.pointerId); fingers.set(e.pointerId, e); span = 0; });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, e => { fingers.delete(e.pointerId); span = 0; });
    canvas.addEventListener("pointermove", e => {
      readOut(canvas, e);
      const last = fingers.get(e.pointerId);
      if (!last) return;
      const box = canvas.getBoundingClientRect();
      fingers.set(e.pointerId, e);
      if (fingers.size === 1) {
        const part = shownPart();
        state.x = (part.left + part.w / 2 - (e.clientX - last.clientX) / box.width * part.w) / width;
        state.y = (part.top + part.h / 2 - (e.clientY - last.clientY) / box.height * part.h) / height;
        drawSoon();
      } else {
        const [a, b] = [...fingers.values()], now = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
        if (span) zoomTo(state.zoom * now / span, ((a.clientX + b.clientX) / 2 - box.left) / box.width, ((a.clientY + b.clientY) / 2 - box.top) / box.height);
        span = now;
      }
    });
    canvas.addEventListener("wheel", e => {
      if (!e.ctrlKey && !e.metaKey) return;
      e.preventDefault();
      const box = canvas.getBoundingClientRect();
      zoomTo(state.zoom * 2 ** (-e.deltaY / 200), (e.clientX - box.left) / box.width, (e.clientY - box.top) / box.height);
    }, {passive: false});
    canvas.addEventListener("dblclick", () => zoomTo(1, 0.5, 0.5));
  }
  byId("theme").addEventListener("click", () => {
    const root = document.documentElement, dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
  });
  for (const link of document.querySelectorAll("nav a")) link.hidden = !document.querySelector(link.getAttribute("href"));
  new ResizeObserver(drawSoon).observe(document.querySelector("main"));
  legend();
  draw();

  // report.html#check: moves the controls as a person would and says in <html data-check="…"> what did not follow.
  function check() {
    const wrong = [], expect = (what, holds) => { if (!holds) wrong.push(what); };
    const pixel = (canvas, fx, fy) => canvas.getContext("2d", readable).getImageData(Math.floor(fx * canvas.width), Math.floor(fy * canvas.height), 1, 1).data.slice(0, 3).join();
    const own = (index, fx, fy, asError) => pixel(drawnPicture(pictures[index], asError), fx, fy);
    const set = (id, value) => { byId(id).value = value; byId(id).dispatchEvent(new Event(byId(id).tagName === "SELECT" ? "change" : "input")); draw(); };
    const brightness = () => { const d = split.getContext("2d", readable).getImageData(0, 0, split.width, split.height).data; let s = 0; for (let i = 0; i < d.length; i += 4) s += d[i] + d[i + 1] + d[i + 2]; return s; };
    set("left", pictures.length - 1); set("right", 0);
    const points = [];
    // Centres of pixels: on a border either neighbour may be drawn.
    const centre = (i, n) => (Math.floor((i + 0.5) / 20 * n) + 0.5) / n;
    for (let i = 0; i < 400; ++i) points.push([centre(i % 20, width), centre(Math.floor(i / 20), height)]);
    for (const at of [0.25, 0.75]) {
      const box = split.getBoundingClientRect();
      moveLine(box.left + at * box.width);
      expect(`line at ${at}`, points.every(([x, y]) => Math.abs(x - at) < 0.02 || pixel(split, x, y) === own(x < at ? pictures.length - 1 : 0, x, y)));
    }
    expect("left and right differ", points.some(([x, y]) => own(0, x, y) !== own(pictures.length - 1, x, y)));
    const before = brightness();
    set("exposure", -3);
    const darker = brightness();
    set("exposure", 3);
    expect("exposure", darker < before && before < brightness());
    set("exposure", 0);
    expect("exposure and back", brightness() === before);
    zoomTo(4, 0, 0); draw();
    expect("zoom of all", [split, ...cells].every(c => c === split || "error" in c.dataset || pixel(c, 0.99, 0.99) === own(c.dataset.picture, 0.2475, 0.2475)));
    zoomTo(1, 0.5, 0.5); draw();
    const errors = cells.filter(c => "error" in c.dataset), white = errorColour(0).join();
    expect("an error", errors.length === 0 || points.some(([x, y]) => pixel(errors[0], x, y) !== white));
    const paper = () => getComputedStyle(document.body).backgroundColor, was = paper();
    byId("theme").click();
    expect("theme", paper() !== was);
    byId("theme").click();
    expect("theme and back", paper() === was);
    const root = document.documentElement;
    delete root.dataset.theme;
    root.dataset.paper = paper();
    root.dataset.check = wrong.length ? "wrong: " + wrong.join("; ") : "right";
    Object.assign(state, {left: pictures.length - 1, right: Math.max(0, pictures.length - 2), split: 0.5});
    byId("left").value = state.left; byId("right").value = state.right;
    draw();
  }
  if (isCheck) check();
})();
