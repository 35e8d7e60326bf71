(() => {
  const {decode, luminance, byteOf} = pixels;
  const data = JSON.parse(document.getElementById("data").textContent);
  const frames = data.frames.map(f => ({number: f.number, rgb: decode(f.halves)})), {width, height, fps} = data;
  const byId = id => document.getElementById(id);
  const isCheck = location.hash === "#check", readable = {willReadFrequently: isCheck};
  const state = {frame: 0, exposure: 0, playing: false, since: 0, from: 0};

  // White at exposure 0: the 99th percentile of the lit pixels of the middle frame.
  const middle = frames[frames.length >> 1].rgb;
  const lit = Float32Array.from({length: width * height}, (_, i) => luminance(middle, i)).filter(l => l > 0 && Number.isFinite(l)).sort();
  const white = lit[Math.floor(0.99 * (lit.length - 1))] || 1;

  const view = byId("view"), slider = byId("frame"), play = byId("play"), thumbs = [...document.querySelectorAll("#strip button")];
  const rows = new Map([...document.querySelectorAll("tr[data-frame]")].map(row => [Number(row.dataset.frame), row]));

  function paint(canvas, k) {
    canvas.width = width; canvas.height = height;
    const context = canvas.getContext("2d", readable), out = context.createImageData(width, height), scale = 2 ** state.exposure / white;
    const {rgb} = frames[k];
    for (let i = 0; i < width * height; ++i) {
      for (let c = 0; c < 3; ++c) out.data[4 * i + c] = byteOf(scale * rgb[3 * i + c]);
      out.data[4 * i + 3] = 255;
    }
    context.putImageData(out, 0, 0);
  }
  function draw() {
    const most = Math.min(view.parentElement.parentElement.clientWidth, 0.7 * Math.max(420, window.innerHeight) * width / height);
    byId("viewer").style.maxWidth = Math.round(most) + "px";
    paint(view, state.frame);
    slider.value = state.frame;
    slider.setAttribute("aria-valuetext", `frame ${frames[state.frame].number}`);
    byId("number").textContent = frames[state.frame].number;
    byId("exposure-value").textContent = (state.exposure < 0 ? "−" : "+") + Math.abs(state.exposure).toFixed(1) + " EV";
    play.textContent = state.playing ? "❚❚" : "▶";
    rows.forEach((row, k) => row.classList.toggle("current", k === state.frame));
    for (const thumb of thumbs) thumb.setAttribute("aria-pressed", Number(thumb.dataset.frame) === state.frame);
  }
  function drawStrip() {
    for (const thumb of thumbs) paint(thumb.querySelector("canvas"), Number(thumb.dataset.frame));
  }
  function show(k) {
    state.frame = Math.min(frames.length - 1, Math.max(0, k));
    draw();
  }

  // Frames follow the clock, so that a slow browser leaves some out.
  function tick(now) {
    if (!state.playing) return;
    const at = (state.from + Math.floor((now - state.since) / 1000 * fps)) % frames.length;
    if (at !== state.frame) show(at);
    requestAnimationFrame(tick);
  }
  function toggle() {
    state.playing = !state.playing && frames.length > 1;
    state.since = performance.now(); state.from = state.frame;
    if (state.playing) requestAnimationFrame(tick);
    draw();
  }
  function choose(k) {
    state.playing = false;
    show(k);
  }

  slider.addEventListener("input", () => choose(Number(slider.value)));
  play.addEventListener("click", toggle);
  byId("exposure").addEventListener("input", e => { state.exposure = Number(e.target.value); draw(); drawStrip(); });
  byId("exposure").addEventListener("dblclick", e => { e.target.value = state.exposure = 0; draw(); drawStrip(); });
  for (const thumb of thumbs) thumb.addEventListener("click", () => choose(Number(thumb.dataset.frame)));
  rows.forEach((row, k) => row.addEventListener("click", () => choose(k)));
  document.addEventListener("keydown", e => {
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    const inControl = e.target.closest && e.target.closest("input, button, a, summary");
    const moves = {ArrowLeft: state.frame - 1, ArrowRight: state.frame + 1, Home: 0, End: frames.length - 1};
    if (e.key === " " && (!inControl || e.target === slider)) toggle();
    else if (e.key in moves && !inControl) choose(moves[e.key]);
    else return;
    e.preventDefault();
  });
  const digits = v => Number.isFinite(v) ? v.toPrecision(3) : String(v);
  view.addEventListener("pointermove", e => {
    const box = view.getBoundingClientRect();
    const x = Math.floor((e.clientX - box.left) / box.width * width), y = Math.floor((e.clientY - box.top) / box.height * height);
    if (x < 0 || y < 0 || x >= width || y >= height) return;
    const i = y * width + x;
    byId("readout").textContent = `frame ${frames[state.frame].number}, pixel ${x}, ${y}: ` + [0, 1, 2].map(c => digits(frames[state.frame].rgb[3 * i + c])).join(" ");
  });
  byId("theme").addEventListener("click", () => {
    const root = document.documentElement, dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
  });
  for (const link of document.querySelectorAll("nav a")) link.hidden = !document.querySelector(link.getAttribute("href"));
  window.addEventListener("resize", draw);
  drawStrip();
  draw();

  // report.html#check: moves the controls as a person would and says in <html data-check="…"> what did not follow.
  function check() {
    const wrong = [], expect = (what, holds) => { if (!holds) wrong.push(what); };
    const bytesOf = canvas => canvas.getContext("2d", readable).getImageData(0, 0, width, height).data.join();
    const key = name => document.dispatchEvent(new KeyboardEvent("keydown", {key: name, bubbles: true}));
    const last = frames.length - 1, first = bytesOf(view);
    expect("first frame", state.frame === 0 && byId("number").textContent === String(frames[0].number));
    slider.value = last; slider.dispatchEvent(new Event("input"));
    expect("slider", state.frame === last && byId("number").textContent === String(frames[last].number));
    expect("frames differ", last === 0 || bytesOf(view) !== first);
    expect("row of the table", rows.size === 0 || (rows.get(last).classList.contains("current") && document.querySelectorAll("tr.current").length === 1));
    key("Home");
    expect("home", state.frame === 0 && bytesOf(view) === first);
    key("ArrowRight");
    expect("right", state.frame === Math.min(1, last));
    key("ArrowLeft"); key("ArrowLeft");
    expect("left", state.frame === 0);
    key("End");
    expect("end", state.frame === last);
    thumbs[0].click();
    expect("strip", state.frame === 0 && thumbs[0].getAttribute("aria-pressed") === "true");
    expect("strip as shown", bytesOf(thumbs[0].querySelector("canvas")) === first);
    const sum = () => view.getContext("2d", readable).getImageData(0, 0, width, height).data.reduce((a, b) => a + b, 0);
    const before = sum(), exposure = byId("exposure");
    exposure.value = -3; exposure.dispatchEvent(new Event("input"));
    expect("exposure", sum() < before);
    exposure.value = 0; exposure.dispatchEvent(new Event("input"));
    expect("exposure and back", bytesOf(view) === first);
    key(" ");
    expect("space plays", state.playing === last > 0);
    tick(state.since + 1000 * (Math.min(2, last) + 0.5) / fps);
    expect("speed", state.frame === Math.min(2, last));
    key(" ");
    expect("space pauses", !state.playing);
    choose(0);
    document.documentElement.dataset.check = wrong.length ? "wrong: " + wrong.join("; ") : "right";
  }
  if (isCheck) check();
})();
