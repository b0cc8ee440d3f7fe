// The words of the figures in both languages.
const WORDS = {
  en: {
    missing: "This figure needs the engine as WebAssembly, which this copy of the site does not have, or a browser that may load it: "
      + "build the site with <code>make docs</code> and open it through a web server, for example <code>python -m http.server</code>.",
    pose: "pose", landmark: "landmark",
    move: "arrow keys move it, Shift with an arrow key to the left or right turns it",
    moveLandmark: "arrow keys move it, and its sightings are measured anew",
    step: "One Gauss-Newton step", all: "All steps", reset: "Dead reckoning",
    psi: "ψ is measured", motions: "motion edges", wrong: "one wrong sighting", kernel: "robust kernel (Cauchy)", ellipses: "covariance ellipses",
    norm: "norm of the last step", steps: (n) => `${n} steps`,
    free: "The edges do not determine all poses: Ω has no inverse.",
    notConverged: "not converged",
    distance: "Mahalanobis distance of an edge:", more: "or more.",
    ellipsesFree: "There is no covariance: the edges do not determine all poses.",
    legend: "Arrows: estimated poses. Dots: the places of the landmarks according to each sighting. Stars: landmarks.",
    drag: "Drag poses, the tips of their arrows, and stars.",
    graphLabel: "graph of poses and landmarks",
  },
  ja: {
    missing: "この図には、WebAssemblyにしたエンジンと、それを読み込めるブラウザが必要です。このサイトには見つかりませんでした。"
      + "<code>make docs</code> でサイトを作り、<code>python -m http.server</code> などのWebサーバ経由で開いてください。",
    pose: "姿勢", landmark: "ランドマーク",
    move: "矢印キーで動かし、Shiftキーと左右の矢印キーで回します",
    moveLandmark: "矢印キーで動かすと、センサ値を測り直します",
    step: "ガウス・ニュートン法を1回", all: "収束まで", reset: "デッドレコニング",
    psi: "ψを計測する", motions: "移動エッジ", wrong: "誤ったセンサ値を1つ入れる", kernel: "ロバストカーネル（Cauchy）", ellipses: "共分散の楕円",
    norm: "最後の更新量のノルム", steps: (n) => `${n}回`,
    free: "エッジだけでは姿勢が一意に決まりません。Ωに逆行列がありません。",
    notConverged: "収束していません",
    distance: "エッジのマハラノビス距離:", more: "以上。",
    ellipsesFree: "姿勢が一意に決まらないので、共分散はありません。",
    legend: "矢印は推定した姿勢、点は各センサ値によるランドマークの位置、星はランドマークです。",
    drag: "姿勢、矢印の先端、星をドラッグできます。",
    graphLabel: "姿勢とランドマークのグラフ",
  },
};

export const wordsOf = (language) => WORDS[language.slice(0, 2)] ?? WORDS.en;
