// Work that several threads do at the same time. The threads end with the work, so that a process can fork afterwards.
#pragma once

namespace vmslam {

/// work(context, 0) to work(context, count - 1) at the same time; what gets no thread is done here.
void in_parallel(int count, void (*work)(const void* context, int), const void* context);

/// work(0) to work(count - 1) at the same time.
template <class Work>
void in_parallel(int count, const Work& work) {
    if (count == 1) return work(0);
    in_parallel(count, [](const void* context, int k) { (*static_cast<const Work*>(context))(k); }, &work);
}

}  // namespace vmslam
