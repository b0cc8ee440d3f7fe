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
    covarianceLabel: "two sightings of a landmark with their covariances",
    misprint: "as the slide prints it, with R₁ in both terms",
    covarianceLegend: "Ellipses: two standard deviations of each sighting (blue and orange), and of the residual (violet, the sum). "
      + "The grey line is the residual e. Drag the poses and the ends of the sightings.",
    fastslamLabel: "particles of FastSLAM, with the map of one of them",
    oneStep: "One step", run: "Run", pause: "Pause", restart: "From the start", other: "Next particle",
    resampling: "resampling", motionNoise: "motion noise ×",
    ess: (ess, n, resampled) => (ess === null ? "no landmark seen yet" : `effective sample size ${ess.toFixed(1)} of ${n}`)
      + (resampled ? ", resampled" : ""),
    fastslamLegend: "Dots: particles, larger with a larger weight. Thin lines: their trajectories. Click a particle to see its trajectory and "
      + "its map (ellipses of two standard deviations); at first it is the one with the largest weight. Dashed line and crosses: ground truth.",
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
    covarianceLabel: "1つのランドマークの2つのセンサ値とその共分散",
    misprint: "スライドの印刷のとおり、両方の項をR₁にする",
    covarianceLegend: "楕円は標準偏差の2倍で、青とオレンジは各センサ値、紫は残差（共分散の和）です。灰色の線が残差eです。姿勢とセンサ値の先端をドラッグできます。",
    fastslamLabel: "FastSLAMのパーティクルと、そのうち1つの地図",
    oneStep: "1ステップ", run: "走らせる", pause: "止める", restart: "最初から", other: "次のパーティクル",
    resampling: "リサンプリング", motionNoise: "移動の雑音 ×",
    ess: (ess, n, resampled) => (ess === null ? "まだランドマークを観測していません" : `有効サンプルサイズ ${ess.toFixed(1)}（N = ${n}）`)
      + (resampled ? "、リサンプリングしました" : ""),
    fastslamLegend: "点はパーティクルで、重みが大きいほど大きく描きます。細い線はその軌跡です。パーティクルをクリックすると、その軌跡と地図（標準偏差の2倍の楕円）を表示します。"
      + "最初は重みが最大のパーティクルです。破線と十字は真の軌跡とランドマークです。",
  },
};

export const wordsOf = (language) => WORDS[language.slice(0, 2)] ?? WORDS.en;
