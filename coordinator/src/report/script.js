(() => {
  "use strict";
  const $ = (id) => document.getElementById(id);
  const block = $("data");
  const table = $("videos");
  if (!block || !table) return;
  const data = JSON.parse(block.textContent);

  // Columns as functions of a row's place.
  const unpack = (packed) => {
    if ("same" in packed) return () => packed.same;
    if (packed.of) return (row) => packed.of[packed.at[row]];
    return (row) => packed.values[row];
  };
  const columns = data.columns.map((packed) => ({
    name: packed.name,
    kind: packed.kind,
    empty: packed.same === null,
    at: unpack(packed),
  }));
  const byName = new Map(columns.map((column) => [column.name, column]));
  const get = (name, row) => byName.get(name)?.at(row) ?? null;
  const playerOf = unpack(data.players);
  const rows = [...Array(data.rows).keys()];
  const placeOf = new Map(rows.map((row) => [get("video", row), row]));
  const file = (row, bit, ending) => {
    const told = data.files?.[row];
    return told && Number(told[0]) & bit ? `videos/${told.slice(1)}${ending}` : null;
  };
  const frameOf = (row) => file(row, 1, ".jpg");
  const heatOf = (row) => file(row, 2, "-heat.jpg");
  const seriesOf = (row) => file(row, 4, ".svg");

  const element = (tag, properties = {}, ...children) => {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...children.filter((child) => child !== null && child !== undefined));
    return made;
  };
  const named = (value) => String(value).replaceAll("_", " ");
  const isSigned = (name) => name.startsWith("z_") || name.startsWith("anomaly") || name === "reward";
  const signed = (value) => (value < 0 ? "" : "+") + value.toFixed(2);
  const show = (name, value) => {
    if (value === null || value === undefined || (Array.isArray(value) && !value.length)) return "–";
    if (Array.isArray(value)) return [...new Set(value)].map(named).join(", ");
    if (typeof value === "boolean") return value ? "yes" : "no";
    if (typeof value !== "number") return String(value);
    if (isSigned(name)) return Math.abs(value) < 1e6 ? signed(value) : value.toExponential(2);
    if (Number.isInteger(value)) return value.toLocaleString("en");
    const size = Math.abs(value);
    return size < 1e-3 || size >= 1e6 ? value.toExponential(2) : String(Number(value.toPrecision(3)));
  };
  const address = (row) => `#v=${encodeURIComponent(get("video", row))}`;

  // ---- the table -------------------------------------------------------------------------------
  const PAGE = 50;
  const usual = ["video", "anomaly", "decision", "rung", "flip_probability", "group", "status", "anomaly_lo", "anomaly_hi",
    ...Object.keys(data.parts).filter((name) => data.parts[name] !== null),
    "worldscore_3d", "worldscore_photometric", "motion_px", "reproj_droid_px", "reproj_px", "aepe_worldscore_px",
    "scene", "paper_peak_frame", "fault_kinds"];
  const usualFirst = [...new Set([...usual, ...byName.keys()])].filter((name) => byName.has(name)).map((name) => byName.get(name));
  const visible = new Set(usual.filter((name) => byName.has(name) && !byName.get(name).empty));
  visible.add("video");
  let order = rows;
  let found = rows;
  let sorted = { name: "anomaly", down: true };
  let page = 0;

  const collator = new Intl.Collator("en", { numeric: true });
  const compare = (a, b) =>
    typeof a === "number" && typeof b === "number" ? a - b : collator.compare(String(a), String(b));
  const key = (column, row) => {
    const value = column.at(row);
    return Array.isArray(value) ? (value.length ? value.join() : null) : value;
  };
  const sort = (name, down) => {
    sorted = { name, down };
    const keyed = rows.map((row) => [key(byName.get(name), row), row]);
    // Missing values stay last either way; equal ones keep the page's order.
    keyed.sort(([a, i], [b, j]) => {
      if (a === null || b === null) return (a === null) - (b === null) || i - j;
      return (down ? compare(b, a) : compare(a, b)) || i - j;
    });
    order = keyed.map(([, row]) => row);
    filter();
  };

  const selects = [];
  const search = element("input", { type: "search", placeholder: "video, group, other texts" });
  const texts = columns.filter((column) => column.kind === "text" && !column.empty);
  const haystacks = rows.map((row) =>
    texts.map((column) => column.at(row) ?? "").join("\n").toLowerCase());
  const filter = () => {
    const wanted = search.value.trim().toLowerCase();
    const chosen = selects.filter((select) => select.box.value !== "");
    found = order.filter((row) =>
      (!wanted || haystacks[row].includes(wanted)) &&
      chosen.every(({ column, box }) => {
        const value = column.at(row);
        return Array.isArray(value) ? value.includes(box.value) : String(value ?? "–") === box.value;
      }));
    page = 0;
    draw();
  };

  const head = () => {
    const line = element("tr");
    for (const column of usualFirst.filter(({ name }) => visible.has(name))) {
      const number = column.kind === "number";
      const button = element("button", { type: "button", title: `Sort by ${column.name}` });
      column.name.split(/(?<=_)/).forEach((part, i) => button.append(...(i ? [element("wbr")] : []), part));
      const cell = element("th", { scope: "col", className: number ? "" : "left" }, button);
      if (sorted.name === column.name) cell.ariaSort = sorted.down ? "descending" : "ascending";
      button.addEventListener("click", () => {
        // Numbers are asked for from their large end.
        sort(column.name, sorted.name === column.name ? !sorted.down : number);
        [...table.tHead.querySelectorAll("button")].find(({ title }) => title === button.title)?.focus();
      });
      line.append(cell);
    }
    table.tHead.replaceChildren(line);
  };
  const name = (row) => {
    const frame = frameOf(row);
    return element("th", { scope: "row", className: "left long" }, element("div", { className: "named" },
      frame && element("img", { className: "thumb", loading: "lazy", decoding: "async", alt: "", src: frame }),
      element("a", { href: address(row), dir: "ltr", textContent: get("video", row) })));
  };
  const cell = (column, row) => {
    if (column.name === "video") return name(row);
    const value = column.at(row);
    const shown = show(column.name, value);
    const made = element("td", { className: column.kind === "number" ? "" : "left" });
    if (column.name === "decision") made.append(element("span", { className: `tag ${value}`, textContent: shown }));
    else made.textContent = column.name === "status" || column.name === "scene" ? named(shown) : shown;
    return made;
  };
  const draw = () => {
    head();
    const first = page * PAGE;
    const shown = found.slice(first, first + PAGE);
    const drawn = usualFirst.filter((column) => visible.has(column.name));
    table.tBodies[0].replaceChildren(
      ...shown.map((row, i) => element("tr", { ariaRowIndex: String(first + i + 2) }, ...drawn.map((column) => cell(column, row)))));
    // The page shows a part: said to those who hear it, headings counted.
    table.ariaRowCount = String(found.length + 1);
    const of = found.length === rows.length ? "" : ` of the ${rows.length.toLocaleString("en")} here`;
    $("shown").textContent = found.length
      ? `${(first + 1).toLocaleString("en")}–${(first + shown.length).toLocaleString("en")} of ${found.length.toLocaleString("en")}${found.length === rows.length ? "" : " found"}${of}`
      : "no video is like that";
    $("before").disabled = page === 0;
    $("after").disabled = first + PAGE >= found.length;
  };
  const turn = (step) => {
    page += step;
    draw();
    $("videos-region").scrollTop = 0;
  };
  $("before").addEventListener("click", () => turn(-1));
  $("after").addEventListener("click", () => turn(1));

  const buildFilters = () => {
    const form = $("filters");
    form.addEventListener("submit", (event) => event.preventDefault());
    form.append(element("label", {}, "Search ", search));
    let waiting = 0;
    search.addEventListener("input", () => {
      clearTimeout(waiting);
      waiting = setTimeout(filter, 80);
    });
    const first = ["status", "decision", "rung", "group", "fault_kinds", "scene"];
    const place = ({ name }) => (first.includes(name) ? first.indexOf(name) : first.length);
    const candidates = columns.filter(({ kind, name }) =>
      kind !== "number" && !["video", "status_reason", "fault_frames", "digest", "profile_digest"].includes(name));
    for (const column of candidates.sort((a, b) => place(a) - place(b))) {
      const values = new Set();
      for (const row of rows) {
        const value = column.at(row);
        for (const one of Array.isArray(value) ? value : [value ?? "–"]) values.add(String(one));
        if (values.size > 400) break;
      }
      const most = first.includes(column.name) ? 400 : 40;
      const least = column.kind === "list" ? 1 : 2;
      if (values.size < least || values.size > most || selects.length === 10) continue;
      const box = element("select", {}, element("option", { value: "", textContent: "all" }),
        ...[...values].sort(collator.compare).map((value) =>
          element("option", { value, textContent: column.kind === "flag" ? (value === "true" ? "yes" : "no") : named(value) })));
      box.dataset.column = column.name;
      box.addEventListener("change", filter);
      selects.push({ column, box });
      form.append(element("label", {}, `${named(column.name)} `, box));
    }
    const clear = element("button", { type: "button", textContent: "Clear" });
    clear.addEventListener("click", () => {
      search.value = "";
      for (const { box } of selects) box.value = "";
      filter();
    });
    form.append(clear);
    form.hidden = false;

    for (const column of columns) {
      const box = element("input", { type: "checkbox", checked: visible.has(column.name), disabled: column.name === "video" });
      box.addEventListener("change", () => {
        if (box.checked) visible.add(column.name);
        else visible.delete(column.name);
        draw();
      });
      $("columns").querySelector(".choices").append(element("label", {}, box, ` ${column.name}`));
    }
    $("columns").hidden = false;
    $("pages").hidden = false;
    if (data.left_out.length) {
      $("left-out").textContent = `Left out to keep the page small, but in scores.*: ${data.left_out.join(", ")}.`;
      $("left-out").hidden = false;
    }
  };

  // ---- one video -------------------------------------------------------------------------------
  const dialog = $("video");
  let open = null;

  const why = (row) => {
    const decision = get("decision", row);
    const anomaly = get("anomaly", row);
    if (decision === "review" || anomaly === null) {
      const reason = get("status_reason", row) ?? "the recipe’s signals are undefined for it";
      return `Not scored (${named(get("status", row))}): ${reason}.`.replace(/\.\.$/, ".");
    }
    const group = get("group", row);
    const [kept, dropped] = data.cuts[group ?? ""] ?? [null, null];
    const of = group === null ? "" : ` of “${group}”`;
    const rule = `the rule “${data.keep}”`;
    let text = decision === "drop"
      ? `Dropped: its anomaly score ${signed(anomaly)} is above what ${rule} keeps${of}${kept === null ? "" : `, up to ${signed(kept)}`}.`
      : `Kept: its anomaly score ${signed(anomaly)} is within what ${rule} keeps${of}${dropped === null ? "" : `; ${signed(dropped)} is the lowest dropped`}.`;
    const cut = decision === "drop" ? kept : dropped;
    const [lo, hi] = [get("anomaly_lo", row), get("anomaly_hi", row)];
    if (cut !== null && lo !== null && hi !== null && lo <= cut && cut <= hi) {
      text += " Uncertain: the 90% interval reaches across that cut.";
    }
    return text;
  };

  const contributions = (row) =>
    Object.entries(data.parts)
      .map(([name, weight]) => ({ name, weight, z: get(name, row) }))
      .map((part) => ({ ...part, share: part.z === null || part.weight === null ? null : part.z * part.weight }))
      .sort((a, b) => (b.share ?? -Infinity) - (a.share ?? -Infinity));
  const parts = (row) => {
    const line = (tag, ...cells) => element("tr", {}, ...cells.map((text, i) =>
      element(i ? tag : "th", { textContent: text, scope: tag === "th" ? "col" : i ? "" : "row" })));
    return element("table", { className: "numbers" },
      element("thead", {}, line("th", "Signal", "z", "weight", "in the score")),
      element("tbody", {}, ...contributions(row).map(({ name, weight, z, share }) =>
        line("td", name, z === null ? "–" : signed(z), weight === null ? "not used" : weight.toFixed(2), share === null ? "–" : signed(share)))));
  };

  const pictures = (row) => {
    const made = [];
    const [frame, heat, source] = [frameOf(row), heatOf(row), playerOf(row)];
    let player = null;
    if (source) {
      player = element("video", { controls: true, preload: "metadata", playsInline: true, muted: true, src: source });
      if (frame) player.poster = frame;
      const note = element("figcaption", { textContent: source });
      player.addEventListener("error", () => {
        note.textContent = `Not to be played from here (${source}).`;
        player.hidden = true;
      });
      made.push(element("figure", { className: "player" }, player, note));
    }
    if (frame) {
      const stack = element("div", { className: "stack" }, element("img", { alt: "The frame with the largest end-point error", src: frame }));
      const caption = element("figcaption", { textContent: "Frame with the largest end-point error" });
      if (heat) {
        const over = element("img", { className: "heat", alt: "Where that error lies", src: heat });
        const slider = element("input", { type: "range", min: 0, max: 100, value: 70 });
        const set = () => { over.style.opacity = slider.value / 100; };
        slider.addEventListener("input", set);
        set();
        stack.append(over);
        caption.append(element("label", {}, " · heat map (black 0, bright 5 px) ", slider));
      }
      made.push(element("figure", {}, stack, caption));
    }
    const map = data.heat_maps[row];
    if (map) {
      made.push(element("figure", {},
        element("a", { href: map }, element("img", { alt: "Heat map of the worst frame", src: map, loading: "lazy" })),
        element("figcaption", { textContent: "Heat map of the worst frame, large" })));
    }
    $("video-pictures").replaceChildren(...made);
    return player;
  };

  const faults = (row, player) => {
    const frames = get("fault_frames", row);
    const kinds = get("fault_kinds", row);
    if (!frames?.length || !kinds) {
      const text = frames ? "No fault was found." : "No fault detector judged it.";
      return [element("p", { className: "quiet", textContent: text })];
    }
    const fps = get("fps", row);
    const list = element("ul", { className: "jumps" }, ...frames.map((frame, i) => {
      const text = `${named(kinds[i])} at frame ${frame}`;
      if (!player || !fps) return element("li", { textContent: text });
      const button = element("button", { type: "button", textContent: text, title: "Show in the player" });
      button.addEventListener("click", () => {
        player.pause();
        player.currentTime = (frame + 0.5) / fps;
        player.scrollIntoView({ block: "nearest" });
      });
      return element("li", {}, button);
    }));
    return [element("h3", { textContent: "Faults, the most severe first" }), list];
  };

  const series = (row) => {
    const source = seriesOf(row);
    if (!source) return [];
    const told = [["mean_error", "mean e_t"], ["max_jump", "largest jump"], ["paper_peak_frame", "t* at frame"]]
      .map(([name, words]) => [words, get(name, row)])
      .filter(([, value]) => value !== null)
      .map(([words, value]) => `${words} ${show("", value)}`);
    return [element("img", {
      className: "series",
      alt: `Series over frames: geometry residual e_t, end-point error with faults, motion. ${told.join(", ")}.`,
      src: source,
    })];
  };

  const present = (row) => {
    open = row;
    $("video-name").textContent = get("video", row);
    $("video-why").textContent = why(row);
    $("video-why").className = get("decision", row);
    const player = pictures(row);
    $("video-series").replaceChildren(...series(row));
    $("video-faults").replaceChildren(...faults(row, player));
    $("video-parts").replaceChildren(parts(row));
    $("video-columns").replaceChildren(...columns.filter((column) => column.at(row) !== null).map((column) =>
      element("div", {}, element("dt", { textContent: column.name }),
        element("dd", { textContent: Array.isArray(column.at(row)) ? column.at(row).join(", ") : String(column.at(row)) }))));
    const place = found.indexOf(row);
    $("video-before").disabled = place <= 0;
    $("video-after").disabled = place < 0 || place === found.length - 1;
    if (!dialog.open) dialog.showModal();
    dialog.scrollTop = 0;
    $("video-name").focus();
  };
  const step = (by) => {
    const next = found[found.indexOf(open) + by];
    if (next === undefined || !found.includes(open)) return;
    history.replaceState(null, "", address(next));
    present(next);
  };
  $("video-before").addEventListener("click", () => step(-1));
  $("video-after").addEventListener("click", () => step(1));
  $("video-close").addEventListener("click", () => dialog.close());
  dialog.addEventListener("keydown", (event) => {
    if (event.target.closest("video, input")) return;
    if (event.key === "ArrowLeft") step(-1);
    if (event.key === "ArrowRight") step(1);
  });
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) dialog.close();
  });
  dialog.addEventListener("close", () => {
    $("video-pictures").replaceChildren();
    open = null;
    if (location.hash.startsWith("#v=")) history.replaceState(null, "", "#table");
  });
  const follow = () => {
    if (!location.hash.startsWith("#v=")) {
      if (dialog.open) dialog.close();
      return;
    }
    let wanted = "";
    try {
      wanted = decodeURIComponent(location.hash.slice(3));
    } catch {
      return;
    }
    const row = placeOf.get(wanted);
    if (row !== undefined) present(row);
  };
  addEventListener("hashchange", follow);
  for (const link of document.querySelectorAll("a.open")) {
    const row = placeOf.get(link.dataset.video);
    if (row !== undefined) link.href = address(row);
  }

  buildFilters();
  draw();
  follow();
})();
