// The gallery: filters, cards, and the large view with its slider. Names are only ever set as text.
"use strict";

(() => {
  const data = nimprep.data("gallery-data");
  const { element } = nimprep;
  const byId = (id) => document.getElementById(id);
  const looks = data.looks;
  const withPictures = new Set(data.shown);
  const PAGE = 24;

  const inline = new Map();
  const address = (frame, look, size) => {
    if (data.served) return `/frame/${frame}/${look}/${size}`;
    if (!inline.has(frame)) {
      if (inline.size > 64) inline.clear();
      inline.set(frame, nimprep.data(`pictures-${frame}`));
    }
    return `data:image/webp;base64,${inline.get(frame)[look]}`;
  };
  const describe = (frame, look) => `${data.ids[frame]}: ${look.about}`;
  const split = (frame) => data.splits[data.split[frame]];
  const percent = (value) => (value > 0 && value < 0.1 ? "< 0.1 %" : `${value.toFixed(1)} %`);

  // ---- filters
  const filters = {};
  for (const name of ["split", "group", "class", "finding", "order", "id"]) filters[name] = byId(`filter-${name}`);
  const fill = (select, first, options) => {
    select.append(element("option", { value: "", textContent: first }));
    for (const [value, text] of options) select.append(element("option", { value: String(value), textContent: text }));
    // A choice of nothing is no choice.
    select.parentElement.hidden = options.length < 1;
  };
  const present = (column) => [...new Set(column)].sort((a, b) => a - b);
  fill(filters.split, "all", present(data.split).map((i) => [i, data.splits[i]]));
  fill(filters.group, "all", present(data.group).filter((i) => data.groups[i]).map((i) => [i, data.groups[i]]));
  fill(filters.class, "any", data.classes.flatMap((c, i) => [[`${i}+`, `with ${c.name}`], [`${i}-`, `without ${c.name}`]]));
  fill(filters.finding, "any", data.findings.flatMap((f, i) => (f.frames.length ? [[i, f.title]] : [])));
  fill(filters.order, "as stored", data.holes ? [["holes", "most holes first"]] : []);

  const flags = data.ids.map(() => []);
  data.findings.forEach((finding, i) => finding.frames.forEach((frame) => flags[frame].push(i)));

  const matching = () => {
    const wanted = filters.id.value.trim().toLowerCase();
    const classFilter = filters.class.value;
    const classIndex = parseInt(classFilter, 10);
    const found = [];
    for (let frame = 0; frame < data.ids.length; frame += 1) {
      if (filters.split.value !== "" && data.split[frame] !== Number(filters.split.value)) continue;
      if (filters.group.value !== "" && data.group[frame] !== Number(filters.group.value)) continue;
      if (classFilter && (data.shares[classIndex][frame] > 0) !== classFilter.endsWith("+")) continue;
      if (filters.finding.value !== "" && !flags[frame].includes(Number(filters.finding.value))) continue;
      if (wanted && !data.ids[frame].toLowerCase().includes(wanted)) continue;
      found.push(frame);
    }
    if (filters.order.value === "holes") found.sort((a, b) => data.holes[b] - data.holes[a] || a - b);
    return found;
  };

  // ---- cards
  const list = byId("frames");
  // Few modalities leave room for several frames in a row.
  list.style.setProperty("--columns", looks.length > 6 ? Math.ceil(looks.length / 2) : looks.length);
  list.style.setProperty("--card", `${13 * Math.min(looks.length, 6)}rem`);
  const more = byId("more");
  let current = []; // Frames of the filter that have pictures, in order.
  let drawn = 0;

  const facts = (frame) => {
    const parts = [];
    if (data.groups[data.group[frame]]) parts.push(data.groups[data.group[frame]]);
    if (data.holes) parts.push(`${percent(data.holes[frame])} holes`);
    data.classes.forEach((c, i) => {
      if (data.shares[i][frame] > 0) parts.push(`${c.name} ${percent(data.shares[i][frame])}`);
    });
    return parts.join(" · ");
  };

  const card = (frame) => {
    const title = element("h3", { id: `frame-${frame}`, textContent: data.ids[frame] });
    const head = element("div", { className: "frame-head" }, title,
      element("span", { className: `split ${split(frame)}`, textContent: split(frame) }),
      element("span", { className: "muted small", textContent: facts(frame) }));
    for (const flag of flags[frame]) head.append(element("span", { className: "tag", textContent: data.findings[flag].title }));
    const strip = element("div", { className: "strip" });
    looks.forEach((look, i) => {
      const image = element("img", {
        className: "pixels", loading: "lazy", decoding: "async", alt: describe(frame, look),
        width: data.width[frame], height: data.height[frame], src: address(frame, look.name, "small"),
      });
      const button = element("button", { type: "button", className: "shot" }, image,
        element("span", { className: "small muted", textContent: look.title, "aria-hidden": "true" }));
      button.addEventListener("click", () => open(frame, i));
      strip.append(button);
    });
    return element("li", { className: "card", "data-frame": frame, "aria-labelledby": `frame-${frame}` }, head, strip);
  };

  const draw = () => {
    const until = Math.min(current.length, drawn + PAGE);
    for (; drawn < until; drawn += 1) list.append(card(current[drawn]));
    more.hidden = drawn >= current.length;
  };
  const update = () => {
    const found = matching();
    current = found.filter((frame) => withPictures.has(frame));
    drawn = 0;
    list.replaceChildren();
    draw();
    const plural = (n) => `${n} ${n === 1 ? "frame matches" : "frames match"}`;
    byId("count").textContent = found.length === current.length
      ? `${plural(found.length)}.`
      : `${plural(found.length)}; pictures of ${current.length} of them are on this page.`;
  };
  for (const filter of Object.values(filters)) filter.addEventListener(filter.tagName === "SELECT" ? "change" : "input", update);
  byId("filters").addEventListener("submit", (event) => event.preventDefault());
  byId("filters").hidden = false;
  more.addEventListener("click", () => {
    const first = drawn;
    draw();
    list.children[first]?.querySelector("button")?.focus();
  });
  for (const button of document.querySelectorAll("[data-finding]")) {
    button.hidden = false;
    button.addEventListener("click", () => {
      for (const filter of Object.values(filters)) filter.value = "";
      filters.finding.value = button.dataset.finding;
      update();
      byId("gallery").scrollIntoView();
      filters.finding.focus({ preventScroll: true });
    });
  }

  // ---- large view
  const dialog = byId("large");
  const [under, over, edge, slide, left, right] = ["under", "over", "edge", "slide", "left", "right"].map(byId);
  let shown = 0;
  let around = []; // The frames that the arrow keys walk through.
  looks.forEach((look, i) => {
    for (const select of [left, right]) select.append(element("option", { value: String(i), textContent: look.title }));
  });

  const place = () => {
    const at = Number(slide.value);
    over.style.clipPath = `inset(0 ${100 - at}% 0 0)`;
    edge.style.left = `${at}%`;
    slide.setAttribute("aria-valuetext", `${at} % ${looks[left.value].title}, ${100 - at} % ${looks[right.value].title}`);
  };
  const key = (target, index) => {
    const legend = byId(`legend-${looks[index].name}`);
    byId(target).replaceChildren();
    if (!legend) return;
    const copy = legend.cloneNode(true);
    copy.removeAttribute("id");
    byId(target).append(copy);
  };
  const show = () => {
    const there = withPictures.has(shown);
    byId("large-title").textContent = data.ids[shown];
    byId("large-facts").replaceChildren(
      element("span", { className: `split ${split(shown)}`, textContent: split(shown) }),
      `${[facts(shown), `${data.width[shown]} × ${data.height[shown]}`, ...flags[shown].map((i) => data.findings[i].title)].filter(Boolean).join(" · ")}`);
    byId("absent").hidden = there;
    byId("compare").hidden = !there;
    byId("compare").style.setProperty("--aspect", data.width[shown] / data.height[shown]);
    if (there) {
      for (const [image, select] of [[over, left], [under, right]]) {
        const look = looks[select.value];
        image.src = address(shown, look.name, "full");
        image.alt = describe(shown, look);
      }
    }
    key("key-left", left.value);
    key("key-right", right.value);
    byId("key-right").hidden = left.value === right.value;
    const position = around.indexOf(shown);
    byId("previous").disabled = position <= 0;
    byId("next").disabled = position < 0 || position >= around.length - 1;
    place();
  };
  function open(frame, index) {
    shown = frame;
    around = current.includes(frame) ? current : [frame];
    left.value = String(index);
    right.value = String(looks.length > 1 && index === 0 ? looks.length - 1 : 0);
    slide.value = "50";
    show();
    if (!dialog.open) dialog.showModal();
  }
  const walk = (step) => {
    const next = around[around.indexOf(shown) + step];
    if (next === undefined) return;
    shown = next;
    show();
  };
  byId("previous").addEventListener("click", () => walk(-1));
  byId("next").addEventListener("click", () => walk(1));
  byId("close").addEventListener("click", () => dialog.close());
  dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });
  dialog.addEventListener("close", () => {
    document.querySelector(`[data-frame="${shown}"] button`)?.focus();
  });
  dialog.addEventListener("keydown", (event) => {
    if (event.target === slide || event.target.tagName === "SELECT") return;
    if (event.key === "ArrowLeft") walk(-1);
    else if (event.key === "ArrowRight") walk(1);
    else return;
    event.preventDefault();
  });
  for (const select of [left, right]) select.addEventListener("change", show);
  slide.addEventListener("input", place);
  const drag = (event) => {
    const box = byId("compare").getBoundingClientRect();
    slide.value = String(Math.round((100 * (event.clientX - box.left)) / box.width));
    place();
  };
  byId("compare").addEventListener("pointerdown", (event) => {
    event.preventDefault();
    byId("compare").setPointerCapture(event.pointerId);
    drag(event);
  });
  byId("compare").addEventListener("pointermove", (event) => { if (event.buttons) drag(event); });

  nimprep.pick["chart-holes"] = (frame) => open(frame, data.depth);
  update();
})();
