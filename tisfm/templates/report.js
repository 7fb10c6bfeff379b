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
