// The moving parts of a page: charts (uPlot) and the view of the bodies (vtk.js), from the data that it carries.
"use strict";
(async () => {
  const COLOURS = ["#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f", "#bcbd22", "#17becf"];
  const TYPES = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, f4: Float32Array, f8: Float64Array };
  const STEPS = 65535;
  const element = (id) => document.getElementById(id);
  const short = (value) => {
    if (!Number.isFinite(value)) return "–";
    const number = Number(value.toPrecision(5));
    const size = Math.abs(number);
    return number !== 0 && (size < 1e-3 || size >= 1e6) ? number.toExponential() : String(number);
  };

  const shorts = (_, values) => values.map((value) => (value == null ? "" : short(value)));

  // An array from its text: base64, gzip, bytes by significance.
  async function unpack(packed) {
    const raw = Uint8Array.from(atob(packed.data), (letter) => letter.charCodeAt(0));
    const stream = new Blob([raw]).stream().pipeThrough(new DecompressionStream("gzip"));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    const kind = TYPES[packed.type];
    const size = kind.BYTES_PER_ELEMENT;
    const count = planes.length / size;
    const bytes = new Uint8Array(planes.length);
    for (let plane = 0; plane < size; plane++)
      for (let k = 0; k < count; k++) bytes[k * size + plane] = planes[plane * count + k];
    return new kind(bytes.buffer);
  }

  // A chart that keeps the width of its place. x is shared by all series; gaps in x separate pieces.
  function chart(place, options, data) {
    const box = document.createElement("div");
    place.append(box);
    const width = () => Math.max(box.clientWidth, 200);
    const series = options.series.map((one, k) => ({
      label: one.label, stroke: COLOURS[k % COLOURS.length], width: 1.5, points: { show: !!options.points },
      value: (_, value) => (value == null ? "–" : short(value)), ...one.style,
    }));
    const plot = new uPlot({
      title: options.title, width: width(), height: 280,
      scales: { x: { time: false, distr: options.logX ? 3 : 1, ...(options.xRange && { range: options.xRange }) }, y: { distr: options.logY ? 3 : 1, range: options.range } },
      axes: [{ label: options.xLabel, values: shorts, ...options.xAxis }, { label: options.yLabel, size: 66, values: shorts }],
      series: [{ label: options.xLabel, value: (_, value) => (value == null ? "–" : short(value)) }, ...series],
      legend: { live: true },
    }, data, box);
    new ResizeObserver(() => plot.setSize({ width: width(), height: 280 })).observe(box);
    return plot;
  }

  async function histories(charts, place) {
    for (const one of charts) {
      const curves = await Promise.all(one.series.map((series) => unpack(series.values)));
      chart(place, one, [await unpack(one.x), ...curves]);
    }
  }

  // Charts of the contact pressure; the function that they return shows another frame.
  async function pressures(charts, place) {
    const shows = [];
    for (const one of charts) {
      const x = await unpack(one.x);
      const frames = await unpack(one.frames);
      const range = () => [0, one.largest * 1.05 || 1];
      const at = (frame) => [x, frames.subarray(frame * x.length, (frame + 1) * x.length)];
      const plot = chart(place, { ...one, range, series: [{ label: `pressure, ${one.yLabel}` }] }, at(0));
      const note = document.createElement("p");
      note.className = "note";
      note.textContent = one.note;
      place.lastElementChild.append(note);
      shows.push((frame) => plot.setData(at(frame)));
    }
    return (frame) => shows.forEach((show) => show(frame));
  }

  // The bodies, in a plane, as cells coloured by a field.
  class View {
    static async create(data, place) {
      const view = new View();
      view.data = data;
      view.place = place;
      for (const name of ["points", "reference", "quads", "triangles", "outline"]) view[name] = await unpack(data[name]);
      view.rigid = data.obstacles ? await unpack(data.obstacles) : null;
      view.solid = {};
      for (const name of ["points", "triangles", "segments"]) view.solid[name] = data.solid && (await unpack(data.solid[name]));
      view.values = await Promise.all(data.fields.map((field) => unpack(field.values)));
      view.count = view.reference.length / 2;
      view.cells = view.quads.length / 4 + view.triangles.length / 3;
      view.polys = View.polys(view.quads, view.triangles);
      view.xyz = new Float32Array(3 * view.count);
      view.shown = new Float32Array(view.cells);
      view.open();
      return view;
    }

    static polys(quads, triangles) {
      const cells = new Uint32Array((quads.length / 4) * 5 + (triangles.length / 3) * 4);
      let at = 0;
      for (let k = 0; k < quads.length; k += 4) { cells[at++] = 4; for (let j = 0; j < 4; j++) cells[at++] = quads[k + j]; }
      for (let k = 0; k < triangles.length; k += 3) { cells[at++] = 3; for (let j = 0; j < 3; j++) cells[at++] = triangles[k + j]; }
      return cells;
    }

    static lines(outline) {
      const cells = new Uint32Array((outline.length / 2) * 3);
      for (let k = 0, at = 0; k < outline.length; k += 2) { cells[at++] = 2; cells[at++] = outline[k]; cells[at++] = outline[k + 1]; }
      return cells;
    }

    open() {
      this.renderer = vtk.Renderer.newInstance({ background: [1, 1, 1] });
      this.window = vtk.RenderWindow.newInstance();
      this.window.addRenderer(this.renderer);
      this.surface = vtk.OpenGLRenderWindow.newInstance();
      this.window.addView(this.surface);
      this.surface.setContainer(this.place);
      this.lookup = vtk.LookupTable.newInstance();
      this.scalars = vtk.DataArray.newInstance({ name: "field", values: this.shown, numberOfComponents: 1 });
      this.bodies = this.add(this.polys, null, { colours: true });
      this.bodies.data.getCellData().setScalars(this.scalars);
      this.before = this.add(null, View.lines(this.outline), { colour: [0.65, 0.65, 0.65], depth: -1e-6 });
      this.rim = this.add(null, View.lines(this.outline), { colour: [0, 0, 0], depth: 1e-6 });
      if (this.rigid) this.addObstacles();
      const still = new Float32Array(3 * this.count);
      this.spread(this.reference, still, this.before.depth);
      this.move(this.before, still);
      this.interact();
      this.resize();
      this.fit();
      new ResizeObserver(() => { this.resize(); this.window.render(); }).observe(this.place);
    }

    add(polys, lines, { colours = false, colour, depth = 0 }) {
      const data = vtk.PolyData.newInstance();
      if (polys) data.getPolys().setData(polys);
      if (lines) data.getLines().setData(lines);
      const mapper = vtk.Mapper.newInstance({ scalarVisibility: colours });
      if (colours) {
        mapper.setScalarModeToUseCellData();
        mapper.setColorModeToMapScalars();
        mapper.setLookupTable(this.lookup);
        mapper.setUseLookupTableScalarRange(true);
      }
      mapper.setInputData(data);
      const actor = vtk.Actor.newInstance();
      actor.setMapper(mapper);
      actor.getProperty().setLighting(false);
      if (colour) actor.getProperty().setColor(...colour);
      this.renderer.addActor(actor);
      return { data, actor, depth: depth * this.size() };
    }

    addObstacles() {
      this.rigidCount = this.rigid.length / 4 / this.data.times.length;
      const ends = Uint32Array.from({ length: 2 * this.rigidCount }, (_, k) => k);
      this.obstacles = this.add(null, View.lines(ends), { colour: [0.35, 0.35, 0.35], depth: 1e-6 });
      this.obstacles.actor.getProperty().setLineWidth(3);
      this.inside = this.add(View.polys([], this.solid.triangles), null, { colour: [0.86, 0.86, 0.86], depth: -2e-6 });
    }

    // Obstacles move without turning: a point of a solid side goes with the start of a segment of it.
    showSolid(frame) {
      const { points, segments } = this.solid;
      const from = 4 * this.rigidCount * frame;
      const xyz = new Float32Array(3 * segments.length);
      segments.forEach((segment, k) => {
        for (let axis = 0; axis < 2; axis++)
          xyz[3 * k + axis] = points[2 * k + axis] + this.rigid[from + 4 * segment + axis] - this.rigid[4 * segment + axis];
        xyz[3 * k + 2] = this.inside.depth;
      });
      this.move(this.inside, xyz);
    }

    showObstacles(frame) {
      this.showSolid(frame);
      const points = 2 * this.rigidCount;
      const xyz = new Float32Array(3 * points);
      for (let k = 0; k < points; k++) {
        xyz[3 * k] = this.rigid[2 * (frame * points + k)];
        xyz[3 * k + 1] = this.rigid[2 * (frame * points + k) + 1];
        xyz[3 * k + 2] = this.obstacles.depth;
      }
      this.move(this.obstacles, xyz);
    }

    size() {
      const [low, high] = this.data.box;
      return Math.max(high[0] - low[0], high[1] - low[1]);
    }

    spread(flat, xyz, depth) {
      for (let k = 0; k < this.count; k++) {
        xyz[3 * k] = flat[2 * k];
        xyz[3 * k + 1] = flat[2 * k + 1];
        xyz[3 * k + 2] = depth;
      }
    }

    move(thing, xyz) {
      thing.data.getPoints().setData(xyz, 3);
      thing.data.getPoints().modified();
      thing.data.modified();
    }

    interact() {
      const interactor = vtk.RenderWindowInteractor.newInstance();
      const style = vtk.InteractorStyleManipulator.newInstance();
      const wheel = { scrollEnabled: true, dragEnabled: false };
      style.addMouseManipulator(vtk.PanManipulator.newInstance({ button: 1 }));
      style.addMouseManipulator(vtk.ZoomManipulator.newInstance({ button: 3 }));
      style.addMouseManipulator(vtk.ZoomManipulator.newInstance(wheel));
      style.addGestureManipulator(vtk.GestureManipulator.newInstance({ rotateEnabled: false }));
      interactor.setView(this.surface);
      interactor.setInteractorStyle(style);
      interactor.initialize();
      interactor.bindEvents(this.place);
    }

    resize() {
      const ratio = window.devicePixelRatio || 1;
      const { width, height } = this.place.getBoundingClientRect();
      this.surface.setSize(Math.max(Math.floor(width * ratio), 10), Math.max(Math.floor(height * ratio), 10));
      const canvas = this.surface.getCanvas();
      canvas.style.width = "100%";
      canvas.style.height = "100%";
    }

    fit() {
      const [low, high] = this.data.box;
      const camera = this.renderer.getActiveCamera();
      const middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
      const { width, height } = this.place.getBoundingClientRect();
      camera.setParallelProjection(true);
      camera.setFocalPoint(...middle, 0);
      camera.setPosition(...middle, 2 * this.size());
      camera.setViewUp(0, 1, 0);
      camera.setParallelScale(0.54 * Math.max(high[1] - low[1], ((high[0] - low[0]) * height) / width));
      camera.setClippingRange(this.size(), 3 * this.size());
      this.window.render();
    }

    // The field that is coloured, and the values at the ends of the colours.
    colour(field, low, high) {
      this.field = field;
      const table = Uint8Array.from(this.data.maps[this.data.fields[field].map].flatMap((c) => [...c, 255]));
      this.lookup.setNumberOfColors(256);
      this.lookup.setTable(vtk.DataArray.newInstance({ values: table, numberOfComponents: 4 }));
      this.lookup.setMappingRange(low, high);
      this.lookup.modified();
    }

    show(frame) {
      this.frame = frame;
      const [low, high] = this.data.box;
      const from = 2 * this.count * frame;
      const flat = new Float32Array(2 * this.count);
      for (let k = 0; k < flat.length; k++) {
        const axis = k % 2;
        flat[k] = low[axis] + ((high[axis] - low[axis]) * this.points[from + k]) / STEPS;
      }
      this.flat = flat;
      const [least, most] = this.data.fields[this.field].range;
      const values = this.values[this.field];
      for (let k = 0; k < this.cells; k++)
        this.shown[k] = least + ((most - least) * values[frame * this.cells + k]) / STEPS;
      const rim = new Float32Array(3 * this.count);
      const body = new Float32Array(3 * this.count);
      this.spread(flat, body, 0);
      this.spread(flat, rim, this.rim.depth);
      this.move(this.bodies, body);
      this.move(this.rim, rim);
      if (this.rigid) this.showObstacles(frame);
      this.scalars.setData(this.shown);
      this.scalars.modified();
      this.window.render();
    }

    edges(on) {
      this.bodies.actor.getProperty().setEdgeVisibility(on);
      this.bodies.actor.getProperty().setEdgeColor(0.35, 0.35, 0.35);
      this.window.render();
    }

    // Where a pointer is, m.
    world(event) {
      const box = this.place.getBoundingClientRect();
      const camera = this.renderer.getActiveCamera();
      const scale = (2 * camera.getParallelScale()) / box.height;
      const [x, y] = camera.getFocalPoint();
      return [x + (event.clientX - box.left - box.width / 2) * scale, y - (event.clientY - box.top - box.height / 2) * scale];
    }

    // The number of the cell at a place, -1 where there is none.
    cellAt([x, y]) {
      let cell = 0;
      for (const [corners, points] of [[4, this.quads], [3, this.triangles]])
        for (let k = 0; k < points.length; k += corners, cell++) {
          let inside = true;
          for (let j = 0; inside && j < corners; j++) {
            const a = 2 * points[k + j];
            const b = 2 * points[k + ((j + 1) % corners)];
            const p = this.flat;
            inside = (p[b] - p[a]) * (y - p[a + 1]) - (p[b + 1] - p[a + 1]) * (x - p[a]) >= 0;
          }
          if (inside) return cell;
        }
      return -1;
    }
  }

  function drawBar(map) {
    const pen = element("bar").getContext("2d");
    map.forEach((colour, k) => { pen.fillStyle = `rgb(${colour})`; pen.fillRect(k, 0, 1, 1); });
  }

  const clockOf = (time, last) => {
    const [factor, unit] = [[1, "s"], [1e3, "ms"], [1e6, "µs"]].find(([f]) => last * f >= 1) || [1e9, "ns"];
    return `${short(time * factor)} ${unit}`;
  };

  async function bodies(data, showPressure) {
    if (!document.createElement("canvas").getContext("webgl2")) throw new Error("there is no WebGL 2");
    const view = await View.create(data, element("canvas"));
    const [field, low, high, time] = ["field", "low", "high", "time"].map(element);
    data.fields.forEach((one, k) => field.add(new Option(one.label, k)));
    time.max = data.times.length - 1;
    time.value = data.start;
    const last = data.times[data.times.length - 1];
    const show = () => {
      const frame = Number(time.value);
      view.show(frame);
      showPressure(frame);
      element("clock").textContent = `t = ${clockOf(data.times[frame], last)}`;
    };
    const limits = () => {
      view.colour(Number(field.value), Number(low.value), Number(high.value));
      element("bar-low").textContent = short(Number(low.value));
      const { unit, range } = data.fields[field.value];
      const [most, top] = [short(Number(high.value)), short(range[1])];
      const beyond = range[1] > Number(high.value) && most !== top ? ` and more, up to ${top}` : "";
      element("bar-high").textContent = `${most}${beyond} ${unit}`;
      show();
    };
    const choose = () => {
      const one = data.fields[field.value];
      [low.value, high.value] = one.limits.map(short);
      drawBar(data.maps[one.map]);
      limits();
    };
    field.onchange = choose;
    low.onchange = high.onchange = () => { if (Number(low.value) < Number(high.value)) limits(); };
    time.oninput = show;
    element("cells").onchange = (event) => view.edges(event.target.checked);
    element("fit").onclick = () => view.fit();
    play(time, show);
    pointer(view, element("canvas"), data);
    choose();
    return view;
  }

  // The button that lets time run.
  function play(time, show) {
    let clock = 0;
    element("play").onclick = (event) => {
      if (clock) { clearInterval(clock); clock = 0; event.target.textContent = "play"; return; }
      event.target.textContent = "pause";
      clock = setInterval(() => { time.value = (Number(time.value) + 1) % (Number(time.max) + 1); show(); }, 100);
    };
  }

  // The value of the material under the pointer.
  function pointer(view, place, data) {
    const under = element("under");
    const help = under.textContent;
    place.addEventListener("pointermove", (event) => {
      const at = view.world(event);
      const cell = view.cellAt(at);
      const { label } = data.fields[view.field];
      under.textContent = cell < 0 ? help : `${label}: ${short(view.shown[cell])} at (${short(at[0])}, ${short(at[1])}) m`;
    });
    place.addEventListener("pointerleave", () => { under.textContent = help; });
  }

  // Whether the values of one axis set those of another: axes that go together make no curves of their own.
  function sets(first, second) {
    const found = new Map();
    return first.values.every((value, k) => {
      if (!found.has(value)) found.set(value, second.values[k]);
      return found.get(value) === second.values[k];
    });
  }

  // An output over an axis, a curve for each choice of the other axes.
  function comparison(data) {
    const [output, axis, logX, logY] = ["output", "axis", "log-x", "log-y"].map(element);
    data.outputs.forEach((one, k) => output.add(new Option(one.name, k)));
    data.axes.forEach((one, k) => axis.add(new Option(one.name, k)));
    const place = element("comparison");
    const draw = () => {
      place.replaceChildren();
      const along = data.axes[axis.value];
      const what = data.outputs[output.value];
      const words = [...new Set(along.values.filter((value) => typeof value === "string"))];
      const x = along.values.map((value) => (typeof value === "string" ? words.indexOf(value) : value));
      const others = [];
      for (const one of data.axes)
        if (one !== along && new Set(one.values).size > 1 && ![along, ...others].some((other) => sets(other, one))) others.push(one);
      const label = (k) => others.map((one) => `${one.name} ${one.values[k]}`).join(", ") || what.name;
      const places = [...new Set(x)].sort((a, b) => a - b);
      const curves = new Map();
      what.values.forEach((value, k) => {
        if (value == null) return;
        if (!curves.has(label(k))) curves.set(label(k), places.map(() => null));
        curves.get(label(k))[places.indexOf(x[k])] = value;
      });
      const points = { points: { show: true, size: words.length ? 10 : 6 }, spanGaps: true };
      if (words.length) points.paths = () => null; // no line leads from one choice to another
      const series = [...curves.keys()].map((name) => ({ label: name, style: points }));
      const options = { title: what.name, xLabel: along.name, yLabel: "", series };
      if (words.length) {
        options.xRange = [-0.5, words.length - 0.5];
        options.xAxis = { splits: () => words.map((_, k) => k), values: () => words };
        const longest = Math.max(...words.map((word) => word.length));
        const [letter, ends] = [6.5, 110]; // pixels of a letter, and what axes take beside the words
        if (longest * letter > (place.clientWidth - ends) / words.length)
          Object.assign(options.xAxis, { rotate: 40, size: Math.min(24 + 0.65 * letter * longest, 160) });
      }
      options.logX = logX.checked && places.every((value) => value > 0);
      options.logY = logY.checked && what.values.every((value) => value == null || value > 0);
      chart(place, options, [places, ...curves.values()]);
    };
    [output, axis, logX, logY].forEach((one) => { one.onchange = draw; });
    draw();
  }

  // One column of the histories of several runs.
  async function overlay(data) {
    const column = element("column");
    data.columns.forEach((name, k) => column.add(new Option(name, k)));
    const times = await Promise.all(data.runs.map((run) => unpack(run.x)));
    const draw = async () => {
      const curves = await Promise.all(data.runs.map((run) => unpack(run.values[column.value])));
      element("overlay").replaceChildren();
      const series = data.runs.map((run) => ({ label: run.name, style: { spanGaps: true } }));
      const joined = uPlot.join(curves.map((curve, k) => [times[k], curve]));
      chart(element("overlay"), { title: data.columns[column.value], xLabel: data.xLabel, yLabel: "", series }, joined);
    };
    column.onchange = draw;
    await draw();
  }

  const data = JSON.parse(element("data").textContent);
  if (data.comparison) comparison(data.comparison);
  if (data.overlay) await overlay(data.overlay);
  if (data.histories) await histories(data.histories, element("histories"));
  const showPressure = data.pressures ? await pressures(data.pressures, element("pressures")) : () => {};
  showPressure(data.start || 0);
  if (data.view) {
    try {
      window.phantomnodeView = await bodies(data.view, showPressure);
    } catch (error) {
      element("view").textContent = `This browser cannot draw the bodies (${error.message}); the pictures show them.`;
    }
  }
  document.documentElement.dataset.ready = "yes";
})();
