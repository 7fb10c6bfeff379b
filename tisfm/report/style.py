"""How a page looks, and what its slider does."""

STYLE = """
:root{--ink:#1c2024;--soft:#5b646d;--page:#f6f7f8;--card:#fff;--line:#dfe3e7;--hold:#eceff1}
@media (prefers-color-scheme:dark){
:root{--ink:#e8eaed;--soft:#a3acb5;--page:#14171a;--card:#1d2125;--line:#343a40;--hold:#272c31}}
*{box-sizing:border-box}
body{margin:0;background:var(--page);color:var(--ink);
font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif}
header,main,footer{max-width:1180px;margin:0 auto;padding:0 16px}
header{padding-top:24px}header p{margin:0;color:var(--soft)}
h1{margin:0 0 8px;font-size:1.7rem;overflow-wrap:anywhere}h2{margin:0 0 10px;font-size:1.1rem}
section{background:var(--card);border:1px solid var(--line);border-radius:10px;padding:16px;
margin:14px 0}
section p{margin:0 0 10px}
dl{display:grid;grid-template-columns:repeat(auto-fill,minmax(150px,1fr));gap:10px 18px;
margin:0}
dl .long{grid-column:1/-1}
dt{color:var(--soft);font-size:.85rem}dd{margin:0;overflow-wrap:anywhere}
.wide{overflow-x:auto}table{border-collapse:collapse;width:100%}
th,td{text-align:left;vertical-align:top;padding:6px 10px;border-top:1px solid var(--line);
overflow-wrap:anywhere}
thead th{border-top:0;color:var(--soft);font-weight:600;font-size:.85rem;white-space:nowrap;
overflow-wrap:normal}
.chip{display:inline-block;white-space:nowrap;padding:0 8px;border-radius:9px;font-size:.9em;
border:2px solid var(--c)}
.advice{color:var(--soft);margin:4px 0 0}
.strip{position:relative;height:14px;border-radius:4px;overflow:hidden;background:var(--hold);
margin-bottom:12px}
.strip i{position:absolute;top:0;bottom:0}
.drawing{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,320px),1fr));gap:10px}
.drawing svg{width:100%;max-width:760px;height:auto;display:block;margin:0 auto}
.control{display:flex;gap:10px;align-items:center;margin-bottom:8px}
.control input{flex:1;min-width:0;height:28px}
button{width:40px;height:32px;border:1px solid var(--line);border-radius:8px;
background:var(--hold);color:inherit;font:inherit;cursor:pointer}
.slide>p{overflow-wrap:anywhere}.slide>p span:not(.chip){color:var(--soft)}
.views{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,var(--w)),1fr));gap:10px}
figure{margin:0;min-width:0}
figure img{width:100%;display:block;border-radius:6px;background:var(--hold)}
figcaption{color:var(--soft);font-size:.85rem}
.none{display:grid;place-items:center;border-radius:6px;background:var(--hold);
color:var(--soft)}
.legend{display:flex;flex-wrap:wrap;gap:4px 10px;align-items:center;margin:8px 0 0;
font-size:.85rem;color:var(--soft)}
.bar{display:inline-block;width:130px;height:12px;border-radius:3px}
.legend img{width:44px;height:44px;border-radius:50%}
summary{cursor:pointer;color:var(--soft);margin-bottom:8px}
footer{padding-bottom:24px;color:var(--soft)}
@media (max-width:560px){td,th{padding:6px 4px}section{padding:12px}thead th{white-space:normal}}
"""

SCRIPT = """
(function () {
  var at = document.getElementById("at"), play = document.getElementById("play");
  if (!at) { return; }
  var slides = document.querySelectorAll("#slides > .slide"), timer = null;
  function show() {
    slides.forEach(function (slide, index) { slide.hidden = index !== Number(at.value); });
  }
  function stop() { clearInterval(timer); timer = null; play.textContent = "▶"; }
  function next() {
    at.value = (Number(at.value) + 1) % slides.length;
    show();
  }
  at.addEventListener("input", function () { stop(); show(); });
  play.addEventListener("click", function () {
    if (timer) { stop(); } else { timer = setInterval(next, 400); play.textContent = "❚❚"; }
  });
  show();
})();
"""
