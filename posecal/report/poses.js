// Poses in two or three dimensions on a canvas: the truth, hypotheses, and the balls of one joint.
{
  const get = (id) => document.getElementById(id);
  const data = JSON.parse(get("pose-data").textContent);
  const [, perPose, nJoints, nAxes] = data.shape;
  const bytes = Uint8Array.from(atob(data.poses), (letter) => letter.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  const canvas = get("pose-canvas");
  const context = canvas.getContext("2d");
  const [order, frame, joint] = [get("pose-order"), get("pose-frame"), get("pose-joint")];
  const camera = { yaw: 0, pitch: 0, zoom: 1 };
  const FRONT = { yaw: 0.5, pitch: 0.12, zoom: 1 };
  const round = (value, digits) => (value === null ? "–" : value.toFixed(digits).replace("-", "−"));
  const unit = data.unit ? ` ${data.unit}` : "";

  // Points of a pose: the truth, the median, and the hypotheses; null where a joint does not count.
  const read = (row) => {
    const { step } = data.frames[row];
    const points = [];
    for (let h = 0; h < perPose; h += 1) {
      const pose = [];
      for (let k = 0; k < nJoints; k += 1) {
        const at = ((row * perPose + h) * nJoints + k) * nAxes * 2;
        const point = [0, 0, 0];
        for (let axis = 0; axis < nAxes; axis += 1) {
          point[axis] = view.getInt16(at + 2 * axis, true);
        }
        pose.push(point[0] === data.missing ? null : point.map((value) => value * step));
      }
      points.push(pose);
    }
    return points;
  };

  const drawable = (points) => points.flat().filter((point) => point !== null);

  // The middle of the truth, and how far nearly all points are from it.
  const extent = (points) => {
    const truth = points[0].filter((point) => point !== null);
    const middle = [0, 1, 2].map((axis) => {
      const values = truth.map((point) => point[axis]);
      return values.length > 0 ? (Math.min(...values) + Math.max(...values)) / 2 : 0;
    });
    const distances = drawable(points).map((point) => Math.hypot(...point.map((value, axis) => value - middle[axis])));
    distances.sort((a, b) => a - b);
    return { middle, reach: distances[Math.floor(0.97 * (distances.length - 1))] || 1 };
  };

  let points = [];
  let scene = { middle: [0, 0, 0], reach: 1 };

  const rows = () => data.orders[order.value];
  const current = () => rows()[Number(frame.value)];

  // Across and down the canvas, and towards the viewer.
  const projection = (width, height) => {
    const scale = (0.46 * Math.min(width, height) * camera.zoom) / scene.reach;
    const [sin, cos] = [Math.sin(camera.yaw), Math.cos(camera.yaw)];
    const [up, level] = [Math.sin(camera.pitch), Math.cos(camera.pitch)];
    const project = (point) => {
      const [x, y, z] = point.map((value, axis) => value - scene.middle[axis]);
      if (nAxes === 2) {
        return [width / 2 + scale * x, height / 2 - scale * y, 0];
      }
      const across = x * cos - y * sin;
      const away = x * sin + y * cos;
      return [width / 2 + scale * across, height / 2 - scale * (z * level + away * up), z * up - away * level];
    };
    return { project, scale };
  };

  const line = (pose, bones) => {
    for (const [a, b] of bones) {
      if (pose[a] !== null && pose[b] !== null) {
        context.moveTo(pose[a][0], pose[a][1]);
        context.lineTo(pose[b][0], pose[b][1]);
      }
    }
  };

  const disc = (point, radius) => {
    context.beginPath();
    context.arc(point[0], point[1], radius, 0, 2 * Math.PI);
  };

  const sideOf = ([a, b]) => {
    const sides = [data.sides[a], data.sides[b]];
    return sides.find((side) => side !== "middle") ?? "middle";
  };

  const alone = [...data.joints.keys()].filter((k) => !data.bones.some((bone) => bone.includes(k)));

  const drawHypotheses = (poses, colour, size) => {
    context.strokeStyle = colour("--hypothesis");
    context.fillStyle = colour("--hypothesis");
    context.lineWidth = 0.7 * size;
    context.globalAlpha = 0.4;
    for (const pose of poses) {
      context.beginPath();
      line(pose, data.bones);
      context.stroke();
      for (const k of alone) {
        if (pose[k] !== null) {
          disc(pose[k], 1.2 * size);
          context.fill();
        }
      }
    }
    context.globalAlpha = 1;
  };

  const drawTruth = (truth, colour, size) => {
    const ofSide = { left: colour("--left"), right: colour("--right"), middle: colour("--under") };
    context.lineCap = "round";
    context.lineWidth = 3.2 * size;
    const bones = [...data.bones].filter(([a, b]) => truth[a] !== null && truth[b] !== null);
    bones.sort((one, other) => truth[one[0]][2] + truth[one[1]][2] - truth[other[0]][2] - truth[other[1]][2]);
    for (const bone of bones) {
      context.strokeStyle = ofSide[sideOf(bone)];
      context.beginPath();
      line(truth, [bone]);
      context.stroke();
    }
    for (const k of alone) {
      if (truth[k] !== null) {
        context.fillStyle = ofSide[data.sides[k]];
        disc(truth[k], 3 * size);
        context.fill();
      }
    }
    context.font = `600 ${12 * size}px system-ui, sans-serif`;
    for (const side of ["left", "right"]) {
      const k = data.sides.lastIndexOf(side);
      if (k >= 0 && truth[k] !== null) {
        context.fillStyle = ofSide[side];
        context.fillText(side === "left" ? "L" : "R", truth[k][0] + 7 * size, truth[k][1] + 4 * size);
      }
    }
  };

  const drawJoint = (poses, k, scale, colour, size) => {
    const [truth, median, ...hypotheses] = poses;
    if (median[k] === null) {
      return;
    }
    context.fillStyle = colour("--cloud");
    context.strokeStyle = colour("--cloud");
    for (const pose of hypotheses) {
      disc(pose[k], 2 * size);
      context.fill();
    }
    if (get("pose-balls").checked) {
      context.lineWidth = 1.3 * size;
      data.frames[current()].radii[k].forEach((radius, number) => {
        context.setLineDash(number === 0 ? [] : [5 * size, 4 * size]);
        disc(median[k], radius * scale);
        context.stroke();
        context.globalAlpha = 0.08;
        context.fill();
        context.globalAlpha = 1;
      });
      context.setLineDash([]);
    }
    context.fillStyle = colour("--ink");
    disc(truth[k], 4 * size);
    context.fill();
  };

  const draw = () => {
    const pixels = window.devicePixelRatio || 1;
    const size = pixels * Math.max(1, canvas.clientWidth / 600); // of lines
    const [width, height] = [canvas.clientWidth * pixels, canvas.clientHeight * pixels].map(Math.round);
    if (canvas.width !== width || canvas.height !== height) {
      [canvas.width, canvas.height] = [width, height];
    }
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name);
    context.clearRect(0, 0, width, height);
    const { project, scale } = projection(width, height);
    const poses = points.map((pose) => pose.map((point) => (point === null ? null : project(point))));
    if (get("pose-hypotheses").checked) {
      drawHypotheses(poses.slice(2), colour, size);
    }
    drawTruth(poses[0], colour, size);
    drawJoint(poses, Number(joint.value), scale, colour, size);
  };

  const percent = (share) => `${Math.round(100 * share)} %`;

  const describe = () => {
    const row = current();
    const { sequence, frame: name, numbers, radii, nearer } = data.frames[row];
    const [area, spread, error, best] = numbers;
    const k = Number(joint.value);
    const [truth, median] = [points[0][k], points[1][k]];
    const lines = [
      ["Sequence", sequence || "–"],
      ["Frame", name],
      ["Error of the median pose", `${round(error, 1)}${unit}`],
      ["Error of the best hypothesis", `${round(best, 1)}${unit} (of ${data.hypotheses.toLocaleString("en")})`],
      ["Predicted spread", `${round(spread, 1)}${unit}`],
      ["Signed area of the pose", `${round(area, 3)} (−0.5: the truth is outside, 0.5: it is central)`],
    ];
    if (median !== null) {
      const distance = Math.hypot(...truth.map((value, axis) => value - median[axis]));
      const said = `${round(distance, 1)}${unit} from the median, farther than ${percent(nearer[k])} of the hypotheses`;
      lines.push([`${data.joints[k]}: truth`, said]);
      const balls = data.shares.map((share, number) => `${percent(share)}: ${round(radii[k][number], 1)}${unit}`);
      lines.push([`${data.joints[k]}: radius of balls`, balls.join(", ")]);
    }
    const nodes = lines.flatMap(([term, text]) => {
      const [dt, dd] = [document.createElement("dt"), document.createElement("dd")];
      [dt.textContent, dd.textContent] = [term, text];
      return [dt, dd];
    });
    get("pose-numbers").replaceChildren(...nodes);
    get("pose-number").value = `${Number(frame.value) + 1} of ${rows().length}`;
    canvas.setAttribute("aria-label", `hypotheses and truth of frame ${name}`);
  };

  const update = () => {
    describe();
    draw();
  };

  const showFrame = () => {
    points = read(current());
    scene = extent(points);
    update();
  };

  const chooseOrder = () => {
    frame.max = rows().length - 1;
    frame.value = 0;
    showFrame();
  };

  const turn = (across, down) => {
    camera.yaw += across;
    camera.pitch = Math.min(1.5, Math.max(-1.5, camera.pitch + down));
    draw();
  };

  const zoom = (factor) => {
    camera.zoom = Math.min(20, Math.max(0.3, camera.zoom * factor));
    draw();
  };

  const pointers = new Map();

  const apart = () => {
    const [a, b] = [...pointers.values()];
    return Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
  };

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
  });

  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (before === undefined) {
      return;
    }
    const distance = pointers.size === 2 ? apart() : 0;
    pointers.set(event.pointerId, event);
    if (pointers.size === 2) {
      zoom(apart() / Math.max(distance, 1));
    } else {
      turn(-0.01 * (event.clientX - before.clientX), 0.01 * (event.clientY - before.clientY));
    }
  });

  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
  }

  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      zoom(Math.exp(-0.0015 * event.deltaY));
    },
    { passive: false },
  );

  const keys = {
    ArrowLeft: () => turn(0.15, 0),
    ArrowRight: () => turn(-0.15, 0),
    ArrowUp: () => turn(0, -0.1),
    ArrowDown: () => turn(0, 0.1),
    "+": () => zoom(1.2),
    "-": () => zoom(1 / 1.2),
  };

  canvas.addEventListener("keydown", (event) => {
    if (keys[event.key]) {
      event.preventDefault();
      keys[event.key]();
    }
  });

  // The names of sequences that have a pose here lead to it.
  for (const row of document.querySelectorAll("#sequences tbody tr")) {
    const [cell] = row.cells;
    const name = cell.textContent;
    const of = Object.keys(data.orders).find((key) => data.orders[key].some((at) => data.frames[at].sequence === name));
    if (of !== undefined) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = name;
      button.title = "Show a pose of this sequence";
      button.addEventListener("click", () => {
        order.value = of;
        chooseOrder();
        frame.value = rows().findIndex((at) => data.frames[at].sequence === name);
        showFrame();
        get("poses").scrollIntoView();
      });
      cell.replaceChildren(button);
    }
  }

  data.joints.forEach((name, k) => {
    joint.add(new Option(name, k));
  });
  for (const option of [...order.options]) {
    if (data.orders[option.value].length === 0) {
      option.remove();
    }
  }
  const first = data.joints.findIndex((name) => /wrist/i.test(name));
  joint.value = first >= 0 ? first : nJoints - 1;
  Object.assign(camera, FRONT);
  order.addEventListener("change", chooseOrder);
  frame.addEventListener("input", showFrame);
  joint.addEventListener("change", update);
  for (const id of ["pose-balls", "pose-hypotheses"]) {
    get(id).addEventListener("change", draw);
  }
  get("pose-reset").addEventListener("click", () => {
    Object.assign(camera, FRONT);
    draw();
  });
  new ResizeObserver(draw).observe(canvas);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  window.addEventListener("beforeprint", draw);
  chooseOrder();
}
